"""Measures the checks of recordings: what they say of measured recordings that were spoilt, and of sound ones.

    python -m bench.sense_faults [FOLDER]

FOLDER, by default that of CES_DATA, holds the measured recordings of `LOGS`. Each is spoilt in each way by itself.
*Right*: a finding names the spoilt signal and what is wrong with it. *Wrong*: another fault is named, or a factor that
does not undo the change. *Silent*: nothing is said. Sound recordings are those, and `look_alikes`.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.look_alikes import draw_look_alikes
from bench.markdown import markdown
from ces_data.arrays import F
from ces_data.checks.check import find_all_faults
from ces_data.checks.motion import is_constant
from ces_data.logs.log_import import import_log
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.recording import Channel, Recording

ROOT = Path(__file__).resolve().parent.parent
LOGS = {"brfd_backlash": "*.json", "dyke_mr": "*.csv", "utfsm_mr": "*.csv"}
SEED = 26
SPEED = "^speed: "  # a logged one contradicts a spoilt position or clock
SAYINGS = ("right", "wrong", "silent")
Change = Callable[[Recording], Recording]


@dataclass(frozen=True)
class SenseFault:
    """A way to spoil a recording; a finding is right if it matches `told`, and harmless if it matches `also`."""

    name: str
    change: Change
    told: str
    also: str = SPEED
    moving_current: bool = False


def change_channel(signal: str, change: Callable[[Channel], Channel]) -> Change:
    """Return a change of one signal."""
    return lambda recording: replace(
        recording, channels={**recording.channels, signal: change(recording.channels[signal])}
    )


def change_values(signal: str, change: Callable[[F], F]) -> Change:
    """Return a change of the values of one signal."""
    return change_channel(signal, lambda channel: replace(channel, values=change(channel.values)))


def scale(signal: str, factor: float) -> Change:
    """Return a change of a signal's unit."""
    return change_values(signal, lambda values: factor * values)


def spikes(signal: str, count: int, size: float) -> Change:
    """Return a change of single samples to a value, in either direction."""

    def spoil(values: F) -> F:
        rng, spoilt = np.random.default_rng(SEED), values.copy()
        spoilt[rng.choice(len(values), count, replace=False)] = size * rng.choice([-1.0, 1.0], count)
        return spoilt

    return change_values(signal, spoil)


def wrap(signal: str, share: float) -> Change:
    """Return a change that wraps a signal at a share of its reach, as a counter that overflows."""

    def spoil(values: F) -> F:
        middle, reach = 0.5 * (values.max() + values.min()), 0.5 * share * np.ptp(values)
        return np.asarray((values - middle + reach) % (2.0 * reach) + middle - reach)

    return change_values(signal, spoil)


def clip(signal: str, share: float) -> Change:
    """Return a change that clips a signal at a share of its reach on both sides of the middle."""

    def spoil(values: F) -> F:
        middle, reach = 0.5 * (values.max() + values.min()), 0.5 * share * np.ptp(values)
        return np.clip(values, middle - reach, middle + reach)

    return change_values(signal, spoil)


def hold(signal: str, last: float, value: float | None = None) -> Change:
    """Return a change that holds a signal from 0.4 of the time on, at `value` or its last one: a lost sensor."""

    def spoil(values: F) -> F:
        held, begin = values.copy(), round(0.4 * len(values))
        held[begin : round(last * len(values))] = values[begin] if value is None else value
        return held

    return change_values(signal, spoil)


def restamp(signals: Sequence[str], change: Callable[[F], F]) -> Change:
    """Return a change of the seconds since the start of some signals."""

    def spoil(channel: Channel) -> Channel:
        start = channel.stamps_ns[0]
        seconds = change((channel.stamps_ns - start) * 1e-9)
        return replace(channel, stamps_ns=start + np.rint(1e9 * seconds).astype(np.int64))

    def apply(recording: Recording) -> Recording:
        spoilt = {name: spoil(recording.channels[name]) for name in signals}
        return replace(recording, channels={**recording.channels, **spoilt})

    return apply


def swap(one: str, other: str) -> Change:
    """Return a change that exchanges two signals."""

    def apply(recording: Recording) -> Recording:
        a, b = recording.channels[one], recording.channels[other]
        swapped = {one: replace(b, name=one, unit=a.unit), other: replace(a, name=other, unit=b.unit)}
        return replace(recording, channels={**recording.channels, **swapped})

    return apply


def lose(signal: str, share: float) -> Change:
    """Return a change that loses samples one by one."""
    rng = np.random.default_rng(SEED)
    return change_channel(signal, lambda channel: channel.select(rng.random(len(channel)) > share))


ALL = ("position", "current", "force")
LATE = r"^(force|position|speed): .*(logged|ms (after|before))|clocks"
KINDS = {  # of faults, by what is in their names; the first that is found
    "spikes": r"^\d+ of", "clock": "^time|ppm", "units": " in ", "signs": "reversed", "wraps or clips": "wraps|clipped",
    "delays": " late", "lost sensor": "held|zero|NaN", "lost samples": "loses", "interchanged": "swapped",
}  # fmt: skip
SCALES = {
    "force in kN": (1e-3, r"\bkN"), "force in lbf": (1 / 4.448, r"\blbf"), "force in kip": (1 / 4448.2, r"\bkip"),
    "force in mN": (1e3, r"\bmN"), "position in mm": (1e3, r"\bmm"), "position in cm": (1e2, r"\bcm"),
    "position in inches": (39.37, "inch"), "position twice in mm": (1e-3, "1000"),
}  # fmt: skip
TIMES = {"ms": (1e3, r"\bms\b"), "µs": (1e6, r"\bus\b|µs"), "minutes": (1 / 60.0, "min")}
CLOCKS: dict[str, tuple[Callable[[F], F], str]] = {
    "time jumps back 0.5 s": (lambda t: t - 0.5 * (t > 0.5 * t[-1]), "back|overlap"),
    "time jumps ahead 5 s": (lambda t: t + 5.0 * (t > 0.5 * t[-1]), "pause|gap"),
    "time reversed": (lambda t: t[-1] - t, "back"),
    "times rounded to 50 ms": (lambda t: np.floor(20.0 * t) / 20.0, "same stamp|round"),
}


def _faults_of(signal: str) -> Iterator[SenseFault]:
    """Yield the faults that position and force have alike."""
    yield SenseFault(f"{signal} reversed", scale(signal, -1.0), "^(force|position): .*(against|sign|-1)")
    for share in (0.8, 0.5):
        percent = f"at {100 * share:.0f} %"
        yield SenseFault(f"{signal} wraps {percent}", wrap(signal, share), f"^{signal}: .*(jump|wrap|overflow|satur)")
        yield SenseFault(f"{signal} clipped {percent}", clip(signal, share), f"^{signal}: .*saturat", f"stuck|{SPEED}")
    for ppm in (-2000, 1000):
        drift = restamp((signal,), lambda t, ppm=ppm: t * (1 + 1e-6 * ppm))  # type: ignore[misc]
        yield SenseFault(f"{signal} {ppm:+d} ppm", drift, f"clock|{LATE}")
    for late in (0.005, 0.02, 0.06):
        yield SenseFault(f"{signal} {1e3 * late:.0f} ms late", _delay(signal, late), LATE)
    yield SenseFault(f"{signal} held 3 % of the time", hold(signal, 0.43), f"^{signal}: .*stuck")
    yield SenseFault(f"{signal} held 15 % of the time", hold(signal, 0.55), f"^{signal}: .*stuck")
    yield SenseFault(f"{signal} zero 5 % of the time", hold(signal, 0.45, 0.0), f"^{signal}: .*stuck")
    yield SenseFault(f"{signal} loses 20 %", lose(signal, 0.2), rf"^{signal}: .*(miss|lost|rate|Hz)")


def _delay(signal: str, seconds: float) -> Change:
    """Return a change that stamps a signal later than it was measured."""
    return restamp((signal,), lambda t: t + seconds)


def _spikes(signal: str, count: int, size: float) -> SenseFault:
    told = rf"^{signal}: .*({count}\b|spike|outl|expected at)"
    return SenseFault(f"{count} of {size:g} in {signal}", spikes(signal, count, size), told)


FAULTS = (
    *(SenseFault(n, scale(n.split()[0], f), f"^{n.split()[0]}: .*{told}") for n, (f, told) in SCALES.items()),
    SenseFault("current in mA", scale("current", 1e3), "^current: .*mA", moving_current=True),
    *(SenseFault(f"time in {u}", restamp(ALL, lambda s, f=f: f * s), f"time.*({t})") for u, (f, t) in TIMES.items()),  # type: ignore[misc]
    *_faults_of("force"),
    *_faults_of("position"),
    SenseFault("both reversed", lambda r: scale("force", -1.0)(scale("position", -1.0)(r)), "sign|both"),
    *(_spikes("force", *spike) for spike in ((12, 999e3), (1, 32767.0), (200, 2e4))),
    *(_spikes("position", *spike) for spike in ((12, 0.5), (1, 10.0))),
    *(SenseFault(name, restamp(ALL, change), told) for name, (change, told) in CLOCKS.items()),
    SenseFault("current 60 ms late", _delay("current", 0.06), "^current: .*ms", "", True),
    *(SenseFault(f"{a} and {b} swapped", swap(a, b), f"{a}|{b}|interchanged") for a, b in (ALL[::2], ALL[:2], ALL[1:])),
    SenseFault("force NaN 5 % of the time", hold("force", 0.45, np.nan), "^force: .*NaN"),
)


def read_measured(folder: Path) -> Iterator[Recording]:
    """Yield the measured recordings that there are."""
    for name, pattern in LOGS.items():
        mapping = load_dyno_mapping(ROOT / "config" / "import" / f"{name}.yaml")
        yield from (import_log(path, mapping) for path in sorted((folder / name).glob(pattern)))


def say(fault: SenseFault, clean: Recording) -> str:
    """Return what the checks say of a recording with a fault: one of SAYINGS, or "" where it cannot have it."""
    if fault.moving_current and is_constant(clean.channels["current"].values):
        return ""
    texts = [finding.text for finding in find_all_faults(fault.change(clean))]
    right = any(re.search(fault.told, text) for text in texts)
    others = [text for text in texts if not re.search(fault.told, text) and not re.search(fault.also, text)]
    return "silent" if not texts else "right" if right and not others else "wrong"


def main(argv: Sequence[str] | None = None) -> int:
    """Spoil all recordings in all ways and print the table; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=os.environ.get("CES_DATA"))
    folder = parser.parse_args(argv).folder
    if folder is None:
        parser.error("no folder with measured recordings; give it, or set CES_DATA")
    recordings = list(read_measured(folder))
    said: dict[str, Counter[str]] = {kind: Counter() for kind in (*KINDS, "all")}
    for fault in FAULTS:
        count = Counter(say(fault, recording) for recording in recordings)
        said[next(kind for kind, words in KINDS.items() if re.search(words, fault.name))] += count
        said["all"] += count
        print(fault.name, dict(count), file=sys.stderr, flush=True)
    rows = [(kind, *(str(count[saying]) for saying in SAYINGS)) for kind, count in said.items()]
    print(markdown([("fault", *SAYINGS), *rows]))
    for name, clean in (("measured", recordings), ("synthetic", list(draw_look_alikes(SEED)))):
        false = [f"{r.name}: {f.text}" for r in clean for f in find_all_faults(r)]
        print(f"\nFindings on {len(clean)} sound {name} recordings: {len(false)}.", *false, sep="\n  ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
