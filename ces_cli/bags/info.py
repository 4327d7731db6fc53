"""`ces info`: a plain look at bags before anything is made of them."""

from __future__ import annotations

import argparse
import json
import math
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from ces_cli.terminal import terminal
from ces_cli.terminal.coverage_picture import require_picture_name, save_picture, terminal_picture
from ces_identify.recordings.bag_reader import list_topics, read_recording
from ces_identify.recordings.bag_storage import Topic
from ces_identify.recordings.channel_stats import ChannelStats, channel_stats
from ces_identify.recordings.checks import Finding, findings
from ces_identify.recordings.coverage import Coverage, coverage
from ces_identify.recordings.recording import Recording
from ces_observer.errors import RecordingError
from ces_observer.signals import UNITS, Constant, Signal, Signals

COLOURS = {"error": "red", "warning": "yellow"}
SHORT_HASH = 12


@dataclass(frozen=True)
class BagReport:
    """What is to be told about one bag."""

    recording: Recording
    topics: tuple[Topic, ...]
    stats: dict[str, ChannelStats]
    findings: tuple[Finding, ...]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError, also after the report if a bag cannot be used."""
    options = _parser().parse_args(argv)
    if options.picture:
        require_picture_name(options.picture)
    signals = terminal.load_described_signals(options)
    looks = [inspect_bag(path, signals) for path in options.bags]
    covered = coverage([look.recording for look in looks])
    if options.json:
        print(json.dumps(_as_json(looks, covered), indent=1, allow_nan=False))
    else:
        _print_report(looks, covered, signals)
    if options.picture:
        save_picture(covered, _title(looks, covered), options.picture)
        terminal.err.print(f"picture: {options.picture}", highlight=False)
    _raise_first_error(looks)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = terminal.parser(
        "info",
        "Look at recordings: signals found, rate, jitter, gaps, ranges in SI units, what is\n"
        "wrong with them, and how their time is spread over speed and current. The exit status\n"
        "is 2 if one of them cannot be used.",
        "ces info bags/sweep bags/noise --picture coverage.png",
    )
    parser.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="rosbag2 folder, or .mcap or .db3 file")
    terminal.add_signals(parser)
    parser.add_argument(
        "--picture", type=Path, metavar="FILE", help="draw the coverage of all bags (.png, .svg or .pdf)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON for other programs instead of tables")
    return parser


def inspect_bag(path: Path, signals: Signals) -> BagReport:
    """Read a bag and look at its channels; raises CesError if it cannot be read."""
    with warnings.catch_warnings(record=True) as caught, terminal.err.status(f"reading {path}"):
        warnings.simplefilter("always")
        recording = read_recording(path, signals)
        topics = list_topics(path)
    told = tuple(Finding("warning", str(warning.message)) for warning in caught)
    stats = {name: channel_stats(channel) for name, channel in recording.channels.items()}
    return BagReport(recording, topics, stats, findings(recording) + told)


def _print_report(looks: list[BagReport], covered: Coverage, signals: Signals) -> None:
    for look in looks:
        _print_line(f"{look.recording.source}  (sha256 {look.recording.sha256[:SHORT_HASH]}…)", "bold")
        for name in look.recording.channels:
            _print_line(f"  {name}: {_place(signals[name])}")
        others = [
            topic for topic in look.topics if not any(s.matches(topic.name) for s in signals.list_topic_signals())
        ]
        if others:
            _print_line(
                "  other topics: " + ", ".join(f"{topic.name} ({topic.type}, {topic.count})" for topic in others)
            )
        terminal.out.print(_table(look))
        for finding in look.findings:
            _print_line(f"  {finding.severity}: {finding.text}", COLOURS[finding.severity])
        _print_line("")
    terminal.out.print(terminal_picture(covered))
    _print_line("(a look only: speed by a non-causal Savitzky-Golay filter)", "dim")


def _print_line(text: str, style: str = "") -> None:
    terminal.out.print(text, style=style, highlight=False, markup=False, soft_wrap=True)


def _place(signal: Signal | Constant) -> str:
    if isinstance(signal, Constant):
        return "constant"
    return f"/{signal.topic.lstrip('/')} {signal.field.text} ({signal.type})"


def _table(look: BagReport) -> Table:
    table = Table(box=box.SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    table.add_column("signal", no_wrap=True)
    for heading in ("samples", "s", "Hz", "jitter\nms", "longest\nms", "gaps", "from", "to"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, stats in look.stats.items():
        table.add_row(f"{name} {look.recording.channel(name).unit}", *_cells(stats))
    for name, value in look.recording.constants.items():
        table.add_row(f"{name} {UNITS[name]}", *[""] * 6, f"{value:.4g}", f"{value:.4g}")
    return table


def _cells(stats: ChannelStats) -> tuple[str, ...]:
    return (
        f"{stats.count}",
        f"{stats.duration_s:.2f}",
        f"{stats.rate_Hz:.1f}",
        f"{1e3 * stats.jitter_s:.3f}",
        f"{1e3 * stats.longest_s:.3f}",
        f"{stats.gaps}",
        f"{stats.low:.4g}",
        f"{stats.high:.4g}",
    )


def _as_json(looks: list[BagReport], covered: Coverage) -> dict[str, Any]:
    recordings = [
        {
            "name": look.recording.name,
            "source": look.recording.source,
            "sha256": look.recording.sha256,
            "topics": [asdict(topic) for topic in look.topics],
            "channels": {
                name: {"unit": look.recording.channel(name).unit, **_finite(asdict(stats))}
                for name, stats in look.stats.items()
            },
            "constants": dict(look.recording.constants),
            "findings": [asdict(finding) for finding in look.findings],
        }
        for look in looks
    ]
    return {
        "schema": "ces-info/1",
        "recordings": recordings,
        "coverage": {
            "speed_edges_m_s": covered.speed_edges.tolist(),
            "current_edges_A": covered.current_edges.tolist(),
            "share": covered.share.tolist(),
            "duration_s": covered.duration_s,
        },
    }


def _finite(figures: dict[str, Any]) -> dict[str, Any]:
    return {key: value if math.isfinite(value) else None for key, value in figures.items()}


def _title(looks: list[BagReport], covered: Coverage) -> str:
    names = [look.recording.name for look in looks]
    told = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return f"{told}: {covered.duration_s:.0f} s\nspeed by non-causal Savitzky-Golay filter, for this look only"


def _raise_first_error(looks: list[BagReport]) -> None:
    for look in looks:
        for finding in look.findings:
            if finding.severity == "error":
                raise RecordingError(f"{look.recording.source}: {finding.text}")
