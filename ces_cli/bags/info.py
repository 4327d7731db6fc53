"""`ces info`: shows what bags contain and whether they can be used."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from ces_cli.terminal import terminal
from ces_cli.terminal.coverage_picture import require_picture_name, save_picture, terminal_picture
from ces_cli.terminal.json_output import add_json, print_document
from ces_identify.recordings.bag_reader import list_topics, read_recording
from ces_identify.recordings.bag_storage import Topic
from ces_identify.recordings.channel_stats import ChannelStats, channel_stats
from ces_identify.recordings.checks import ERROR, WARNING, WRONG_MODEL, Finding, findings, sort_findings
from ces_identify.recordings.coverage import Coverage, coverage
from ces_identify.recordings.recording import Recording
from ces_identify.sense.sense import sense
from ces_observer.errors import RecordingError
from ces_observer.signals import UNITS, Constant, Signal, Signals

COLOURS = {ERROR: "red", WRONG_MODEL: "red", WARNING: "yellow"}
SHORT_HASH = 12


@dataclass(frozen=True)
class BagReport:
    """One recording with the topics of its bag, statistics of its channels, and findings."""

    recording: Recording
    topics: tuple[Topic, ...]
    stats: dict[str, ChannelStats]
    findings: tuple[Finding, ...]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError, after the report if a bag cannot be used."""
    options = make_parser().parse_args(argv)
    if options.picture:
        require_picture_name(options.picture)
    signals = terminal.load_described_signals(options)
    reports = [_inspect_bag(path, signals) for path in options.bags]
    covered = coverage([report.recording for report in reports])
    if options.json:
        print_document("info", _as_json(reports, covered))
    else:
        _print_report(reports, covered, signals)
    if options.picture:
        save_picture(covered, _title(reports, covered), options.picture)
        terminal.err.print(f"picture: {options.picture}", highlight=False)
    _raise_first_error(reports)
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    parser = terminal.parser(
        "info",
        "Inspect recordings: signals, rate, jitter, gaps, ranges in SI units, faults, and the distribution of time "
        "over speed and current. The exit status is 2 if a recording cannot be used.",
        "ces info bags/sweep bags/noise --picture coverage.png",
    )
    parser.add_argument("bags", type=Path, nargs="+", metavar="BAG", help="rosbag2 folder, or .mcap or .db3 file")
    terminal.add_signals(parser)
    text = "draw the coverage of all bags (.png, .svg or .pdf)"
    parser.add_argument("--picture", type=Path, metavar="FILE", help=text)
    add_json(parser)
    return parser


def _inspect_bag(path: Path, signals: Signals) -> BagReport:
    with warnings.catch_warnings(record=True) as caught, terminal.err.status(f"reading {path}"):
        warnings.simplefilter("always")
        recording = read_recording(path, signals)
        topics = list_topics(path)
    warned = tuple(Finding(WARNING, str(warning.message)) for warning in caught)
    stats = {name: channel_stats(channel) for name, channel in recording.channels.items()}
    return BagReport(recording, topics, stats, _find_faults(recording) + warned)


def _find_faults(recording: Recording) -> tuple[Finding, ...]:
    """Return the faults of a recording, and what makes no sense in it if it can be read."""
    faults = findings(recording)
    return faults if any(f.severity == ERROR for f in faults) else sort_findings(faults, sense(recording))


def _print_report(reports: list[BagReport], covered: Coverage, signals: Signals) -> None:
    for report in reports:
        _print_line(f"{report.recording.source}  (sha256 {report.recording.sha256[:SHORT_HASH]}…)", "bold")
        for name in report.recording.channels:
            _print_line(f"  {name}: {_describe_source(signals[name])}")
        others = [t for t in report.topics if not any(s.matches(t.name) for s in signals.list_topic_signals())]
        if others:
            _print_line("  other topics: " + ", ".join(f"{t.name} ({t.type}, {t.count})" for t in others))
        terminal.out.print(_table(report))
        for finding in report.findings:
            _print_line(f"  {finding.severity}: {finding.text}", COLOURS[finding.severity])
        _print_line("")
    terminal.out.print(terminal_picture(covered))
    _print_line("(for this overview only, a non-causal Savitzky-Golay filter computes the speed)", "dim")


def _print_line(text: str, style: str = "") -> None:
    terminal.out.print(text, style=style, highlight=False, markup=False, soft_wrap=True)


def _describe_source(signal: Signal | Constant) -> str:
    if isinstance(signal, Constant):
        return "constant"
    return f"/{signal.topic.lstrip('/')} {signal.field.text} ({signal.type})"


def _table(report: BagReport) -> Table:
    headings = ("samples", "s", "Hz", "jitter\nms", "longest\nms", "gaps", "from", "to")
    table = terminal.make_table(None, ("signal",), headings)
    for name, stats in report.stats.items():
        table.add_row(f"{name} {report.recording.channel(name).unit}", *_cells(stats))
    for name, value in report.recording.constants.items():
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


def _as_json(reports: list[BagReport], covered: Coverage) -> dict[str, Any]:
    recordings = [
        {
            "name": report.recording.name,
            "source": report.recording.source,
            "sha256": report.recording.sha256,
            "topics": [asdict(topic) for topic in report.topics],
            "channels": {
                name: {"unit": report.recording.channel(name).unit, **asdict(stats)}
                for name, stats in report.stats.items()
            },
            "constants": dict(report.recording.constants),
            "findings": [asdict(finding) for finding in report.findings],
        }
        for report in reports
    ]
    return {
        "recordings": recordings,
        "coverage": {
            "speed_edges_m_s": covered.speed_edges,
            "current_edges_A": covered.current_edges,
            "share": covered.share,
            "duration_s": covered.duration_s,
        },
    }


def _title(reports: list[BagReport], covered: Coverage) -> str:
    names = [report.recording.name for report in reports]
    text = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return f"{text}: {covered.duration_s:.0f} s\nspeed from a non-causal Savitzky-Golay filter, for this overview only"


def _raise_first_error(reports: list[BagReport]) -> None:
    for report in reports:
        for finding in report.findings:
            if finding.severity == ERROR:
                raise RecordingError(f"{report.recording.source}: {finding.text}")
