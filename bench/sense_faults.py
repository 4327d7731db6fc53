"""Measures the checks of recordings: detection rates of faults put into sound ones, and false alarms.

    python -m bench.sense_faults [--plants N]

Recordings: those of `sense_judges`, which no threshold was set with. Measured data join in if CES_DATA names their
folder; they were in view. Each fault is put into each recording by itself.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.markdown import markdown
from bench.sense_judges import JUDGING, draw_judges
from ces_data.arrays import F
from ces_data.checks.check import check_recording
from ces_data.checks.delays import DelayEstimate, current_delay, force_delay
from ces_data.checks.motion import is_constant, recorded_motion
from ces_data.findings import WRONG_MODEL, Finding
from ces_data.logs.log_import import import_log
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.recording import Channel, Recording

ROOT = Path(__file__).resolve().parent.parent
LOGS = {"brfd_backlash": "*.json", "dyke_mr": "*.csv", "utfsm_mr": "*.csv"}
NUMBER = re.compile(r"\b\d+\b(?!\.)")
Change = Callable[[Recording], Recording]


@dataclass(frozen=True)
class SenseFault:
    """A fault: how it changes a recording, and the signals of which a finding must speak."""

    name: str
    change: Change
    signals: tuple[str, ...]


@dataclass
class Count:
    """Recordings with a fault, and those in which it was reported or refused; `others` name other signals, too."""

    recordings: int = 0
    reported: int = 0
    refused: int = 0
    others: int = 0

    def add(self, found: Sequence[Finding], signals: Sequence[str]) -> None:
        """Count the findings on one recording."""
        mine = [f for f in found if f.text.split(":")[0] in signals]
        self.recordings += 1
        self.reported += bool(mine)
        self.refused += any(f.severity == WRONG_MODEL for f in mine)
        self.others += len(found) > len(mine)


def change_values(signal: str, change: Callable[[F], F]) -> Change:
    """Return a change of the values of one signal."""

    def apply(recording: Recording) -> Recording:
        channel = recording.channels[signal]
        changed = replace(channel, values=change(channel.values))
        return replace(recording, channels={**recording.channels, signal: changed})

    return apply


def delay_signal(signal: str, seconds: float) -> Change:
    """Return a change that stamps a signal later than it was measured."""

    def apply(recording: Recording) -> Recording:
        channel = recording.channels[signal]
        changed = replace(channel, stamps_ns=channel.stamps_ns + round(seconds * 1e9))
        return replace(recording, channels={**recording.channels, signal: changed})

    return apply


def sample_at(rate_Hz: float) -> Change:
    """Return a change that keeps samples at a lower rate, without a filter, as a slow logger does."""

    def apply(recording: Recording) -> Recording:
        def thin(channel: Channel) -> Channel:
            ticks = np.floor((channel.stamps_ns - channel.stamps_ns[0]) * 1e-9 * rate_Hz + 1e-6)
            return channel.select(np.diff(ticks, prepend=-1.0) > 0.0)

        return replace(recording, channels={name: thin(channel) for name, channel in recording.channels.items()})

    return apply


def clip(signal: str, share: float) -> Change:
    """Return a change that clips a signal at a share of its reach on both sides of the middle."""

    def apply(values: F) -> F:
        middle, reach = 0.5 * (values.max() + values.min()), 0.5 * share * np.ptp(values)
        return np.clip(values, middle - reach, middle + reach)

    return change_values(signal, apply)


def quantise(signal: str, levels: int) -> Change:
    """Return a change that leaves a number of levels between the percentiles of a signal."""

    def apply(values: F) -> F:
        step = float(np.ptp(np.percentile(values, (1.0, 99.0)))) / levels
        return np.asarray(step * np.round(values / step))

    return change_values(signal, apply)


def hold_stretch(signal: str, first: float = 0.4, last: float = 0.5, value: float | None = None) -> Change:
    """Return a change that holds a signal, at `value` or its last one, for a part of the time: a lost sensor."""

    def apply(values: F) -> F:
        held, begin = values.copy(), round(first * len(values))
        held[begin : round(last * len(values))] = values[begin] if value is None else value
        return held

    return change_values(signal, apply)


def hold_samples(signal: str, samples: int) -> Change:
    """Return a change that repeats each sample, as a logger does that is faster than its sensor."""
    return change_values(signal, lambda values: values[np.arange(len(values)) // samples * samples])


TIMING = ("force", "position", "current")
FAULTS = (
    SenseFault("none", lambda recording: recording, ()),
    SenseFault("force reversed", change_values("force", np.negative), ("force",)),
    SenseFault("position reversed", change_values("position", np.negative), ("force",)),
    SenseFault("force in kN", change_values("force", lambda v: 1e-3 * v), ("force",)),
    SenseFault("position in mm", change_values("position", lambda v: 1e3 * v), ("position",)),
    SenseFault("position in inches", change_values("position", lambda v: v / 0.0254), ("position",)),
    SenseFault("current in mA", change_values("current", lambda v: 1e3 * v), ("current",)),
    SenseFault("current in percent of 1.6 A", change_values("current", lambda v: v / 0.016), ("current",)),
    *(
        SenseFault(f"{signal} {1e3 * abs(s):.0f} ms {'late' if s > 0 else 'early'}", delay_signal(signal, s), TIMING)
        for signal, delays in (
            ("force", (2, 5, 10, 20, 50, -2, -5, -10, -20, -50)),
            ("current", (10, 20, 50, -20, -50)),
        )
        for s in (1e-3 * delay for delay in delays)
    ),
    *(SenseFault(f"all at {rate} Hz", sample_at(rate), ("force",)) for rate in (200, 100, 50)),
    SenseFault("force clipped at 80 %", clip("force", 0.8), ("force",)),
    SenseFault("force clipped at 50 %", clip("force", 0.5), ("force",)),
    SenseFault("position clipped at 80 %", clip("position", 0.8), ("position",)),
    SenseFault("position clipped at 50 %", clip("position", 0.5), ("position",)),
    SenseFault("position with 40 levels", quantise("position", 40), ("position",)),
    SenseFault("position with 150 levels", quantise("position", 150), ("position",)),
    SenseFault("force with 20 levels", quantise("force", 20), ("force",)),
    *(
        SenseFault(f"{signal} stuck for 10 % of the time", hold_stretch(signal), (signal,))
        for signal in ("position", "force", "current")
    ),
    SenseFault("current stuck in the second half", hold_stretch("current", 0.5, 1.0), ("current",)),
    SenseFault("force held at 100 Hz", hold_samples("force", 10), ("force",)),
)


def read_measured(folder: Path) -> Iterator[Recording]:
    """Yield the measured recordings that there are."""
    for name, pattern in LOGS.items():
        mapping = load_dyno_mapping(ROOT / "config" / "import" / f"{name}.yaml")
        yield from (import_log(path, mapping) for path in sorted((folder / name).glob(pattern)))


def count_findings(recordings: Sequence[Recording]) -> list[tuple[str, Count]]:
    """Return the count of each fault over all recordings."""
    rows = []
    for fault in FAULTS:
        count = Count()
        for recording in recordings:
            if "current" in fault.name and is_constant(recording.channels["current"].values):
                continue
            count.add(check_recording(fault.change(recording)), fault.signals)
        rows.append((fault.name, count))
        print(f"{fault.name}: {count}", file=sys.stderr, flush=True)
    return rows


def delay_rows(recordings: Sequence[Recording]) -> list[str]:
    """Return rows of how well delays are estimated, where the interval excludes zero."""
    rows: list[tuple[str, ...]] = []
    for signal, delays_ms in (("force", (-20, -10, 10, 20)), ("current", (-50, 20, 50))):
        for true in (1e-3 * ms for ms in delays_ms):
            found = [d for r in recordings if (d := _estimate(delay_signal(signal, true)(r), signal)) and d.certain]
            if found:
                errors = [1e3 * abs(d.late_s - true) for d in found]
                inside = sum(d.low_s <= true <= d.high_s for d in found)
                name, size = f"{signal} {1e3 * true:+.0f} ms", f"{np.median(errors):.1f}"
                rows.append((name, str(len(found)), size, f"{max(errors):.1f}", f"{inside} of {len(found)}"))
    return [markdown([("delay", "certain", "median error, ms", "largest, ms", "interval holds it"), *rows])]


def _estimate(recording: Recording, signal: str) -> DelayEstimate | None:
    motion = recorded_motion(recording)
    if motion is None:
        return None
    return force_delay(motion) if signal == "force" else current_delay(motion)


def format_table(drawn: Sequence[tuple[str, Count]], measured: Sequence[tuple[str, Count]]) -> str:
    """Return the table of faults; those that differ by their first number share a row."""
    others = dict(measured)
    families: dict[str, list[tuple[str, Count, Count | None]]] = {}
    for name, count in drawn:
        families.setdefault(NUMBER.sub("#", name, count=1), []).append((name, count, others.get(name)))
    lines = [("fault", "drawn: reported", "drawn: refused", "measured: reported")]
    for family, rows in families.items():
        values = ", ".join(found[0] for name, *_ in rows if (found := NUMBER.search(name)))
        known = [one for *_, one in rows if one is not None]
        lines.append(
            (
                family.replace("#", values),
                f"{_join(c.reported for _, c, _ in rows)} of {rows[0][1].recordings}",
                _join(c.refused for _, c, _ in rows),
                f"{_join(c.reported for c in known)} of {known[0].recordings}" if known else "-",
            )
        )
    return markdown(lines)


def _join(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the campaign and print its tables; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", type=int, default=1, help="plants of each kind and excitation (default 1)")
    options = parser.parse_args(argv)
    began = time.monotonic()
    judging = list(draw_judges(JUDGING, options.plants))
    drawn = count_findings(judging)
    folder = os.environ.get("CES_DATA")
    measured = count_findings(list(read_measured(Path(folder)))) if folder else []
    print("\n".join([format_table(drawn, measured), "", *delay_rows(judging)]))
    print(f"{time.monotonic() - began:.0f} s", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
