"""The findings of the sense check, in the same words in all programs that read recordings."""

from __future__ import annotations

from collections.abc import Sequence

from ces_cli.terminal import terminal
from ces_identify.recordings.checks import Finding
from ces_identify.recordings.recording import Recording
from ces_identify.sense.sense import sense_each


def print_findings(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """Print what is wrong with recordings, each and together, one warning line each; return it for --json."""
    findings = sense_each(recordings)
    for finding in findings:
        terminal.print_warning(finding.text)
    return findings
