"""What the checks say about a sample recording into which one fault at a time is put: a table of docs/checks.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.reference.tables import table
from bench.sense_faults import FAULTS, SenseFault, change_values
from ces_data.checks.check import find_all_faults, find_differences
from ces_data.findings import Finding
from ces_data.reading import read_recording
from ces_data.recording import Recording

ROOT = Path(__file__).resolve().parents[2]
SAMPLE, FIRST_S, SECONDS = ROOT / "bags" / "noise", 2.0, 8.0
DIFFERENCES = ("force reversed",)


def step_back(recording: Recording) -> Recording:
    """Return a recording whose clock is set back by 20 ms once."""
    stamps = recording.channels["position"].stamps_ns.copy()
    stamps[4000:] -= 20_000_000
    return _with_position(recording, stamps_ns=stamps)


def count_ms_as_s(recording: Recording) -> Recording:
    """Return a recording whose times are in ms, but were taken for s."""
    start = min(int(channel.stamps_ns[0]) for channel in recording.channels.values())
    slower = {n: replace(c, stamps_ns=1000 * (c.stamps_ns - start)) for n, c in recording.channels.items()}
    return replace(recording, channels=slower)


def lose_force(recording: Recording) -> Recording:
    """Return a recording without a sample of the force."""
    force = recording.channels["force"]
    empty = replace(force, stamps_ns=force.stamps_ns[:0], values=force.values[:0])
    return replace(recording, channels={**recording.channels, "force": empty})


def _with_position(recording: Recording, **changes: object) -> Recording:
    position = replace(recording.channels["position"], **changes)  # type: ignore[arg-type]
    return replace(recording, channels={**recording.channels, "position": position})


STRUCTURAL = (
    SenseFault("no force samples", lose_force, ("force",)),
    SenseFault("clock set back", step_back, ("position",)),
    SenseFault("times in ms", count_ms_as_s, ("position",)),
    SenseFault(
        "force with spikes", change_values("force", lambda v: np.where(np.arange(len(v)) % 700, v, 999e3)), ("force",)
    ),
    SenseFault(
        "position's counter overflows", change_values("position", lambda v: (v + 0.01) % 0.025 - 0.01), ("position",)
    ),
)
SHOWN = (
    *STRUCTURAL, *(fault for fault in FAULTS if fault.name in (
        "force in kN", "force 20 ms late", "current 50 ms late", "all at 100 Hz", "force clipped at 50 %",
        "position stuck for 10 % of the time",
    )),
)  # fmt: skip


def findings_table() -> str:
    """Return the table."""
    recording = cut(read_recording(SAMPLE))
    rows = []
    for fault in SHOWN:
        found = [f for f in find_all_faults(fault.change(recording)) if f.signal in ("", *fault.signals)]
        rows.append((fault.name, found[0].severity, _plain(found[0].text)))
    by_name = {fault.name: fault for fault in FAULTS}
    for name in DIFFERENCES:
        other = replace(by_name[name].change(recording), name="b")
        between: Sequence[Finding] = find_differences([replace(recording, name="a"), other])
        rows += [(f"{name}, in one of several", f.severity, _plain(f.text)) for f in between[:1]]
    return table(("fault", "severity", "text"), rows).rstrip()


def cut(recording: Recording) -> Recording:
    """Return some seconds of a recording."""
    start = min(channel.stamps_ns[0] for channel in recording.channels.values())
    ends = (start + 1e9 * np.array([FIRST_S, FIRST_S + SECONDS])).astype(np.int64)
    inside = {name: (c.stamps_ns >= ends[0]) & (c.stamps_ns < ends[1]) for name, c in recording.channels.items()}
    return replace(recording, channels={name: c.select(inside[name]) for name, c in recording.channels.items()})


def _plain(text: str) -> str:
    return text[0].upper() + text[1:]
