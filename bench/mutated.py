"""Measures what is said of measured recordings that were spoilt: told right, told wrong, or nothing at all.

    python -m bench.mutated FOLDER [--cases 200] [--seed N]

FOLDER holds the measured recordings (`bench.sense_faults.LOGS`). Each case spoils one of them in one way, drawn from
the seed. *Right*: a finding names the spoilt signal and what is wrong with it. *Wrong*: another fault is named, or a
factor that does not undo the change. *Silent*: nothing is said; then `identify` shows what the silence costs: J on
the last quarter, of the spoilt recording and of the clean one, by a model of the spoilt first three quarters, over that
of the clean recording by its own model.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.random import Generator

from bench.look_alikes import draw_look_alikes
from bench.markdown import markdown
from bench.sense_faults import Change, change_values, clip, delay_signal, hold_stretch, read_measured
from ces_data.arrays import F
from ces_data.checks.check import find_all_faults
from ces_data.checks.motion import is_constant
from ces_data.recording import Recording
from ces_identify.identification import identify
from ces_identify.numerics.search import Limits
from ces_identify.prepare.series import prepare
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.validation.evaluate import VALIDATION, evaluate
from ces_observer.errors import CesError

HARM = 1.5  # ratio of J above which silence counts
Make = Callable[[Recording, Generator], Recording]


@dataclass(frozen=True)
class Mutation:
    """A way to spoil a recording; a finding is right if it matches `told`, and harmless if it matches `also`."""

    kind: str
    name: str
    make: Make
    told: str
    also: str = "$^"
    moving_current: bool = False


def scale(signal: str, factor: float) -> Make:
    """Return a change of a signal's unit."""
    return _ignore_dice(change_values(signal, lambda values: factor * values))


def _ignore_dice(change: Change) -> Make:
    return lambda recording, _: change(recording)


def both(*changes: Make) -> Make:
    """Return a change made of several."""

    def make(recording: Recording, rng: Generator) -> Recording:
        for one in changes:
            recording = one(recording, rng)
        return recording

    return make


def spikes(signal: str, count: int, size: float) -> Make:
    """Return a change of single samples to a value, in either direction."""

    def make(recording: Recording, rng: Generator) -> Recording:
        at = rng.choice(len(recording.channels[signal]), count, replace=False)
        signs = rng.choice([-1.0, 1.0], count)

        def spoil(values: F) -> F:
            spoilt = values.copy()
            spoilt[at] = size * signs
            return spoilt

        return change_values(signal, spoil)(recording)

    return make


def wrap(signal: str, share: float) -> Make:
    """Return a change that wraps a signal at a share of its reach, as a counter that overflows."""

    def spoil(values: F) -> F:
        middle, reach = 0.5 * (values.max() + values.min()), 0.5 * share * np.ptp(values)
        return np.asarray((values - middle + reach) % (2.0 * reach) + middle - reach)

    return _ignore_dice(change_values(signal, spoil))


def restamp(signals: Sequence[str], change: Callable[[F], F]) -> Make:
    """Return a change of the seconds since the start of some signals."""

    def make(recording: Recording, _: Generator) -> Recording:
        channels = dict(recording.channels)
        for name in signals:
            channel = channels[name]
            start = channel.stamps_ns[0]
            stamps = start + np.rint(1e9 * change((channel.stamps_ns - start) * 1e-9)).astype(np.int64)
            channels[name] = replace(channel, stamps_ns=stamps)
        return replace(recording, channels=channels)

    return make


def swap(one: str, other: str) -> Make:
    """Return a change that exchanges two signals."""

    def make(recording: Recording, _: Generator) -> Recording:
        a, b = recording.channels[one], recording.channels[other]
        swapped = {one: replace(b, name=one, unit=a.unit), other: replace(a, name=other, unit=b.unit)}
        return replace(recording, channels={**recording.channels, **swapped})

    return make


def lose(signal: str, share: float) -> Make:
    """Return a change that loses samples one by one."""

    def make(recording: Recording, rng: Generator) -> Recording:
        channel = recording.channels[signal]
        kept = channel.select(rng.random(len(channel)) > share)
        return replace(recording, channels={**recording.channels, signal: kept})

    return make


ALL = ("position", "current", "force")
FORCE_UNIT, POSITION_UNIT = "^force: .*", "^position: .*"
LATE = r"^(force|position): .*(logged|ms (after|before))|clocks"
FACTORS = {"kN": (1e-3, r"\bkN"), "lbf": (1 / 4.448, r"\blbf"), "kip": (1 / 4448.2, r"\bkip"), "mN": (1e3, r"\bmN")}
LENGTHS = {"mm": (1e3, r"\bmm"), "cm": (1e2, r"\bcm"), "inch": (39.37, "inch"), "twice in mm": (1e-3, "1000")}
TIMES = {"ms": (1e3, r"\bms\b"), "us": (1e6, r"\bus\b|µs"), "minutes": (1 / 60.0, "min")}

MUTATIONS = (
    *(Mutation("units", f"force in {u}", scale("force", f), FORCE_UNIT + t) for u, (f, t) in FACTORS.items()),
    *(Mutation("units", f"position in {u}", scale("position", f), POSITION_UNIT + t) for u, (f, t) in LENGTHS.items()),
    *(
        Mutation("units", f"time in {u}", restamp(ALL, lambda s, f=f: f * s), f"time.*({t})")  # type: ignore[misc]
        for u, (f, t) in TIMES.items()
    ),
    Mutation("units", "current in mA", scale("current", 1e3), "^current: .*mA", moving_current=True),
    Mutation("signs", "force reversed", scale("force", -1.0), "^force: .*(against|sign|-1)"),
    Mutation("signs", "position reversed", scale("position", -1.0), "^(force|position): .*(against|sign|-1)"),
    Mutation("signs", "both reversed", both(scale("force", -1.0), scale("position", -1.0)), "sign|both"),
    *(
        Mutation("spikes", f"{n} of {size:g} in {s}", spikes(s, n, size), rf"^{s}: .*({n}\b|spike|outl|expected at)")
        for s, n, size in (
            ("force", 12, 999e3),
            ("force", 1, 32767.0),
            ("force", 200, 2e4),
            ("position", 12, 0.5),
            ("position", 1, 10.0),
        )
    ),
    *(
        Mutation("wraps", f"{s} wraps at {100 * share:.0f} %", wrap(s, share), f"^{s}: .*(jump|wrap|overflow|saturat)")
        for s in ("force", "position")
        for share in (0.5, 0.8)
    ),
    *(
        Mutation(
            "wraps", f"{s} clipped at {100 * share:.0f} %", _ignore_dice(clip(s, share)), f"^{s}: .*saturat", "stuck"
        )
        for s in ("force", "position")
        for share in (0.5, 0.8)
    ),
    *(
        Mutation("clocks", f"{s} {ppm:+d} ppm", restamp((s,), lambda t, p=ppm: t * (1 + 1e-6 * p)), f"clock|{LATE}")  # type: ignore[misc]
        for s in ("force", "position")
        for ppm in (-2000, 1000)
    ),
    Mutation("clocks", "time jumps back 0.5 s", restamp(ALL, lambda t: t - 0.5 * (t > 0.5 * t[-1])), "back|overlap"),
    Mutation("clocks", "time jumps ahead 5 s", restamp(ALL, lambda t: t + 5.0 * (t > 0.5 * t[-1])), "pause|gap"),
    Mutation("clocks", "time reversed", restamp(ALL, lambda t: t[-1] - t), "back"),
    Mutation("clocks", "times rounded to 50 ms", restamp(ALL, lambda t: np.floor(20.0 * t) / 20.0), "same stamp|round"),
    *(
        Mutation("delays", f"{s} {1e3 * d:+.0f} ms", _ignore_dice(delay_signal(s, d)), LATE)
        for s in ("force", "position")
        for d in (0.005, 0.02, 0.06)
    ),
    Mutation("delays", "current +60 ms", _ignore_dice(delay_signal("current", 0.06)), "^current: .*ms", "", True),
    Mutation("swaps", "position and force", swap("position", "force"), "interchanged|position"),
    Mutation("swaps", "current and force", swap("current", "force"), "force|current"),
    Mutation("swaps", "position and current", swap("position", "current"), "position|current"),
    *(
        Mutation("dropouts", f"{s} {what}", _ignore_dice(hold_stretch(s, 0.4, last, value)), f"^{s}: .*stuck")
        for s in ("force", "position")
        for what, last, value in (("held 3 %", 0.43, None), ("held 15 %", 0.55, None), ("zero 5 %", 0.45, 0.0))
    ),
    Mutation("dropouts", "force NaN 5 %", _ignore_dice(hold_stretch("force", 0.4, 0.45, np.nan)), "^force: .*NaN"),
    Mutation("dropouts", "force loses 20 %", lose("force", 0.2), "^force: .*(miss|lost|rate|Hz)"),
    Mutation("dropouts", "position loses 20 %", lose("position", 0.2), "^position: .*(miss|lost|rate|Hz)"),
)


@dataclass(frozen=True)
class Outcome:
    """What was said of a spoilt recording: right, wrong or silent, with the texts; ratios of J where silent."""

    recording: str
    mutation: Mutation
    said: str
    texts: tuple[str, ...]
    ratios: tuple[float, float] = (0.0, 0.0)


def run_cases(recordings: Sequence[Recording], cases: int, seed: int) -> Iterator[Outcome]:
    """Yield the outcome of each drawn case; every mutation comes as often as the others, and so do the recordings."""
    rng = np.random.default_rng(seed)
    pairs = [(m, r) for m in MUTATIONS for r in recordings if not m.moving_current or not _fixed_current(r)]
    order: list[tuple[Mutation, Recording]] = []
    used: Counter[str] = Counter()
    for k in range(cases):
        mutation = MUTATIONS[k % len(MUTATIONS)]
        free = [r for m, r in pairs if m is mutation and (m, r) not in order] or [r for m, r in pairs if m is mutation]
        least = min(used[r.name] for r in free)
        chosen = free[int(rng.choice([i for i, r in enumerate(free) if used[r.name] == least]))]
        used[chosen.name] += 1
        order.append((mutation, chosen))
    for mutation, recording in order:
        yield _outcome(mutation, recording, mutation.make(recording, rng))


def _fixed_current(recording: Recording) -> bool:
    return "current" not in recording.channels or is_constant(recording.channels["current"].values)


def _outcome(mutation: Mutation, clean: Recording, spoilt: Recording) -> Outcome:
    texts = tuple(f"{f.severity}: {f.text}" for f in find_all_faults(spoilt))
    plain = [text.split(": ", 1)[1] for text in texts]
    if not plain:
        return Outcome(clean.name, mutation, "silent", texts, _loss(clean, spoilt))
    right = any(re.search(mutation.told, text) for text in plain)
    others = [t for t in plain if not re.search(mutation.told, t) and not re.search(mutation.also, t)]
    return Outcome(clean.name, mutation, "right" if right and not others else "wrong", texts)


def _loss(clean: Recording, spoilt: Recording) -> tuple[float, float]:
    """Return by how much J on the last quarter of the spoilt and of the clean recording grows, by a model of the rest.

    0 where the program refuses: nothing is silent then.
    """
    options = IdentifyOptions(limits=Limits(time=20.0), split=0.75, band=False)
    try:
        of_clean, of_spoilt = (identify([r], options=options).model for r in (clean, spoilt))
        usual, own, true = (
            evaluate(m, [prepare(r, m.sampling).part(0.75, 1.0)], VALIDATION)[0].cost
            for m, r in ((of_clean, clean), (of_spoilt, spoilt), (of_spoilt, clean))
        )
    except CesError as error:
        print(f"refused: {error}", file=sys.stderr)
        return 0.0, 0.0
    return float(own / usual), float(true / usual)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the cases and print their table; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=26)
    options = parser.parse_args(argv)
    recordings = list(read_measured(options.folder))
    counts: dict[str, Counter[str]] = {m.kind: Counter() for m in MUTATIONS}
    for outcome in run_cases(recordings, options.cases, options.seed):
        count = counts[outcome.mutation.kind]
        count[outcome.said] += 1
        for where, ratio in zip(("own", "clean"), outcome.ratios, strict=True):
            count[where] += not ratio <= HARM
        if outcome.said != "right":
            ratios = "" if outcome.said == "wrong" else "J {:.2f} {:.2f} times ".format(*outcome.ratios)
            print(f"{outcome.said}: {outcome.mutation.name} in {outcome.recording} {ratios}{outcome.texts}", flush=True)
    harm = f"J above {HARM:g} times"
    rows = [("spoilt", "right", "wrong", "silent", f"its own {harm}", f"clean data's {harm}")]
    sums: Counter[str] = sum(counts.values(), Counter())
    for kind, count in [*counts.items(), ("all", sums)]:
        rows.append((kind, *(str(count[s]) for s in ("right", "wrong", "silent", "own", "clean"))))
    print(markdown(rows))
    for name, clean in (("measured", recordings), ("synthetic", list(draw_look_alikes(options.seed)))):
        false = [f"{r.name}: {f.text}" for r in clean for f in find_all_faults(r)]
        print(f"findings on {len(clean)} clean {name} recordings: {len(false)}", *false, sep="\n  ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
