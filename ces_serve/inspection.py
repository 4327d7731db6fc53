"""The page of a recording: what `ces info` says of it, with its signals as a chart. Runs in a process of its own."""

from __future__ import annotations

import warnings
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ces_data.bags.reader import list_topics, read_recording
from ces_data.checks.check import find_all_faults
from ces_data.findings import Finding
from ces_data.recording import Channel, Recording
from ces_data.samples import channel_stats
from ces_data.signals_file import load_signals
from ces_report.plot import Plot, PlotArea, PlotLine, draw_plot, series_css
from ces_serve.contents import WIDTH, PageContent, PageTable
from ces_serve.items import format_number

FORMS = {  # of the columns: the statistic, its heading and its form
    "count": ("samples", "d"),
    "duration_s": ("s", ".2f"),
    "rate_Hz": ("Hz", ".1f"),
    "jitter_s": ("jitter s", ".2g"),
    "gaps": ("gaps", "d"),
    "low": ("from", ".4g"),
    "high": ("to", ".4g"),
}
MAX_POINTS = 5000  # of a line


def inspect_recording(path: str, signals: str | None) -> PageContent:
    """Return signals with statistics, findings, a chart and the other topics of a recording. Raises CesError."""
    described = load_signals(Path(signals) if signals else None)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(Path(path), described)
        topics = list_topics(Path(path))
    found = (*find_all_faults(recording), *(Finding("warning", str(warning.message)) for warning in caught))
    rows = [_row(f"{name} [{channel.unit}]", channel) for name, channel in recording.channels.items()]
    rows += [(name, *["–"] * 5, *[format_number(value, ".4g")] * 2) for name, value in recording.constants.items()]
    tables = [PageTable("Signals", ("signal", *(heading for heading, _ in FORMS.values())), tuple(rows))]
    used = described.list_topic_signals()
    others = [topic for topic in topics if not any(signal.matches(topic.name) for signal in used)]
    if others:
        cells = tuple((topic.name, topic.type, format_number(topic.count, "d")) for topic in others)
        tables.append(PageTable("Other topics", ("topic", "type", "messages"), cells))
    return PageContent(
        facts=[("sha256", f"{recording.sha256[:16]}…")],
        warnings=[f"{one.severity}: {one.text}" for one in found],
        charts=_chart(recording),
        tables=tables,
    )


def _row(name: str, channel: Channel) -> tuple[str, ...]:
    stats = asdict(channel_stats(channel))
    return (name, *(format_number(stats[key], form).replace("nan", "–") for key, (_, form) in FORMS.items()))


def _chart(recording: Recording) -> list[str]:
    """Return the signals against time, one area below the other."""
    start_ns = min((int(c.stamps_ns.min()) for c in recording.channels.values() if len(c)), default=0)
    areas = []
    for k, (name, channel) in enumerate(recording.channels.items()):
        if len(channel) < 2:
            continue
        order = np.argsort(channel.stamps_ns, kind="stable")
        time_s = 1e-9 * np.asarray(channel.stamps_ns[order] - start_ns, np.float64)
        line = PlotLine(name, time_s, np.asarray(channel.values[order], np.float64), series_css(k))
        areas.append(PlotArea(f"{name.capitalize()} [{channel.unit}]", [line], height=110.0))
    plot = Plot("signals", "Signals over time", "The signals as logged.", "Time [s]", areas, WIDTH, legend=False)
    return [draw_plot(plot, MAX_POINTS)] if areas else []
