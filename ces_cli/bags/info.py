"""`ces info`: shows what bags contain and whether they can be used, or what a model file says."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from rich.table import Table

from ces_cli.terminal import terminal
from ces_cli.terminal.options import BAGS, BAGS_FORM, JSON, SIGNALS, ProgramRequest
from ces_cli.terminal.outputs import print_document
from ces_cli.terminal.results import terminal_picture
from ces_data.bags.find import find_bags
from ces_data.bags.reader import list_topics, read_recording
from ces_data.bags.storage import Topic
from ces_data.checks.check import find_all_faults
from ces_data.findings import ERROR, WARNING, WRONG_MODEL, Finding
from ces_data.log_formats import is_log, is_ours
from ces_data.recording import Recording
from ces_data.samples import ChannelStats, Coverage, channel_stats, coverage
from ces_data.signals_file import load_signals
from ces_observer.errors import CesError, RecordingError
from ces_observer.model import load_model
from ces_observer.records import declare
from ces_observer.signals import UNITS, Signal, Signals
from ces_report.table import text_table

COLOURS = {ERROR: "red", WRONG_MODEL: "red", WARNING: "yellow"}
SHORT_HASH = 12


@dataclass(frozen=True)
class BagReport:
    """One recording with the topics of its bag, statistics of its channels, and findings."""

    recording: Recording
    topics: tuple[Topic, ...]
    stats: dict[str, ChannelStats]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True)
class InfoRequest(ProgramRequest):
    """Inspect recordings: signals, rate, jitter, gaps, ranges in SI units, faults, and the distribution of time over
    speed and current; or a model: its size, ranges and proof. The exit status is 2 if one cannot be used.
    """

    program = "info"
    example = "ces info bags/sweep bags/noise"

    bags: tuple[str, ...] = declare(replace(BAGS, meaning=f"recordings: {BAGS_FORM}; or a MODEL.json"))
    signals: Path | None = declare(SIGNALS)
    json: bool = declare(JSON)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError, after the report if a bag cannot be used."""
    request = terminal.read(InfoRequest, argv)
    models = [Path(word) for word in request.bags if is_ours(Path(word))]
    if models and request.json:
        raise CesError(f"{models[0]}: a model is JSON already; omit --json, or the model")
    for path in models:
        _print_model(path)
    paths = find_bags([word for word in request.bags if Path(word) not in models])
    if not paths:
        return 0
    signals = load_signals(request.signals)
    reports = [_inspect_bag(path, signals) for path in paths]
    covered = coverage([report.recording for report in reports])
    if request.json:
        print_document("info", _as_json(reports, covered))
    else:
        _print_report(reports, covered, signals)
    for report in reports:
        for finding in report.findings:
            if finding.severity == ERROR:
                raise RecordingError(f"{report.recording.source}: {finding.text}")
    return 0


def _inspect_bag(path: Path, signals: Signals) -> BagReport:
    with warnings.catch_warnings(record=True) as caught, terminal.step(f"reading {path}"):
        warnings.simplefilter("always")
        topics = () if is_log(path) else list_topics(path)
        recording = terminal.read_one(path, signals) if is_log(path) else read_recording(path, signals)
    warned = tuple(Finding(WARNING, str(warning.message)) for warning in caught)
    stats = {name: channel_stats(channel) for name, channel in recording.channels.items()}
    return BagReport(recording, topics, stats, find_all_faults(recording) + warned)


def _print_model(path: Path) -> None:
    """Print what a model file says, its stability proved anew; raises CesError if the file is no model."""
    model = load_model(path)
    sampling, ends = model.sampling, (*model.envelope.by_signal.items(), ("force", model.force_envelope_N))
    proof = "proved for every input" if model.is_stable() else model.body.unproved
    terminal.print_line(f"{path}  (sha256 {model.digest()[:SHORT_HASH]}…)", "bold")
    terminal.print_line(f"  model: {model.structure}, {model.size}")
    terminal.print_line(
        f"  {sampling.rate_Hz:g} Hz; force after {model.warm_up_s:g} s; delay {sampling.delay_s:g} s; bridges lost "
        f"samples for {sampling.max_gap_s:g} s"
    )
    for name, (low, high) in ends:
        gap = model.envelope.gap_text if name == "current" else ""
        terminal.print_line(f"  {name} from {_format_value(low)} to {_format_value(high)} {UNITS[name]}{gap}")
    terminal.print_line(f"  inputs outside are {model.body.outside}; stability: {proof}")


def _print_report(reports: list[BagReport], covered: Coverage, signals: Signals) -> None:
    for report in reports:
        terminal.print_line(f"{report.recording.source}  (sha256 {report.recording.sha256[:SHORT_HASH]}…)", "bold")
        for name in report.recording.channels:
            signal = signals[name]
            source = "of the log" if is_log(Path(report.recording.source)) else "constant"
            if isinstance(signal, Signal) and report.topics:
                source = f"/{signal.topic.lstrip('/')} {signal.field.text} ({signal.type})"
            terminal.print_line(f"  {name}: {source}")
        others = [t for t in report.topics if not any(s.matches(t.name) for s in signals.list_topic_signals())]
        if others:
            terminal.print_line("  other topics: " + ", ".join(f"{t.name} ({t.type}, {t.count})" for t in others))
        terminal.print_table(_table(report))
        for finding in report.findings:
            terminal.print_line(f"  {finding.severity}: {finding.text}", COLOURS[finding.severity])
        terminal.print_line("")
    terminal.out.print(terminal_picture(covered))
    terminal.print_line("(for this overview only, a non-causal Savitzky-Golay filter computes the speed)", "dim")


def _table(report: BagReport) -> Table:
    rows: list[Sequence[str]] = []
    for name, s in report.stats.items():
        times = (f"{s.duration_s:.2f}", f"{s.rate_Hz:.1f}", f"{1e3 * s.jitter_s:.3f}", f"{1e3 * s.longest_s:.3f}")
        unit = report.recording.channel(name).unit
        ends = _format_value(s.low), _format_value(s.high)
        rows.append((f"{name} {unit}", f"{s.count}", *times, f"{s.gaps}", *ends))
    for name, value in report.recording.constants.items():
        rows.append((f"{name} {UNITS[name]}", *[""] * 6, _format_value(value), _format_value(value)))
    headings = ("signal", "samples", "s", "Hz", "jitter\nms", "longest\nms", "gaps", "from", "to")
    table = terminal.lay_out(text_table(headings, rows))
    table.columns[0].no_wrap = True
    return table


def _format_value(value: float) -> str:
    """Return a value with four digits, and large ones, such as forces in N, without an exponent."""
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e9 else f"{value:.4g}"


def _as_json(reports: list[BagReport], covered: Coverage) -> dict[str, Any]:
    recordings = [
        {
            "name": report.recording.name,
            "source": report.recording.source,
            "sha256": report.recording.sha256,
            "topics": report.topics,
            "channels": {
                name: {"unit": report.recording.channel(name).unit, **asdict(stats)}
                for name, stats in report.stats.items()
            },
            "constants": report.recording.constants,
            "findings": report.findings,
        }
        for report in reports
    ]
    edges = {"speed_edges_m_s": covered.speed_edges, "current_edges_A": covered.current_edges}
    return {"recordings": recordings, "coverage": {**edges, "share": covered.share, "duration_s": covered.duration_s}}
