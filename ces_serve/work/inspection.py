"""What `ces info` says of a recording, as plain values, with its signals reduced to a chart's points."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.recordings.bag_reader import list_topics, read_recording
from ces_identify.recordings.channel_stats import channel_stats
from ces_identify.recordings.checks import ERROR, Finding, findings, sort_findings
from ces_identify.recordings.recording import Channel
from ces_identify.recordings.signals_file import load_signals
from ces_identify.sense.sense import sense

MAX_BINS = 600  # of a chart's line: the lowest and highest value of each
MIN_GAP_S, MIN_GAP_STEPS = 0.05, 10.0  # [s] and sampling intervals: what counts as a gap everywhere
SECOND = 1e9


def inspect_recording(path: str, signals: str | None, report: Callable[[str], None]) -> dict[str, Any]:
    """Return signals with statistics, findings, other topics and lines of a recording. Raises CesError."""
    described = load_signals(Path(signals) if signals else None)
    report("reading the bag")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(Path(path), described)
        topics = list_topics(Path(path))
    faults = findings(recording)
    if not any(fault.severity == ERROR for fault in faults):
        faults = sort_findings(faults, sense(recording))
    found = faults + tuple(Finding("warning", str(warning.message)) for warning in caught)
    used = described.list_topic_signals()
    start_ns = min((int(c.stamps_ns.min()) for c in recording.channels.values() if len(c)), default=0)
    return {
        "sha256": recording.sha256,
        "channels": [
            {"name": name, "unit": channel.unit, **_finite(asdict(channel_stats(channel))), **_line(channel, start_ns)}
            for name, channel in recording.channels.items()
        ],
        "constants": dict(recording.constants),
        "findings": [asdict(finding) for finding in found],
        "topics": [asdict(topic) for topic in topics if not any(signal.matches(topic.name) for signal in used)],
    }


def _line(channel: Channel, start_ns: int) -> dict[str, Any]:
    """Return the channel's line: `time_s` and `value`, the extremes of each bin, and None in a gap."""
    good = np.isfinite(channel.values)
    time_s, value = (channel.stamps_ns[good] - start_ns) / SECOND, channel.values[good]
    order = np.argsort(time_s, kind="stable")
    if len(order) > 2 * MAX_BINS:
        parts = np.array_split(order, MAX_BINS)
        ends = [
            sorted((part[np.argmin(value[part])], part[np.argmax(value[part])]), key=time_s.__getitem__)
            for part in parts
        ]
        order = np.array(ends).ravel()
    shown_s, shown = _interrupt(time_s[order], value[order], np.sort(time_s))
    return {
        "time_s": np.round(shown_s, 4).tolist(),
        "value": [float(f"{v:.6g}") if math.isfinite(v) else None for v in shown],
    }


def _interrupt(time_s: F, value: F, logged_s: F) -> tuple[F, F]:
    """Return a line (n,) with a NaN in each gap between the logged times that is wide enough to see."""
    steps = np.diff(logged_s)
    if not len(steps):
        return time_s, value
    least = max(MIN_GAP_S, MIN_GAP_STEPS * float(np.median(steps)), float(logged_s[-1] - logged_s[0]) / MAX_BINS)
    gaps = np.flatnonzero(steps > least)
    middle = 0.5 * (logged_s[gaps] + logged_s[gaps + 1])
    places = np.searchsorted(time_s, middle)
    return np.insert(time_s, places, middle), np.insert(value, places, np.nan)


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    return {key: value if math.isfinite(value) else None for key, value in values.items()}
