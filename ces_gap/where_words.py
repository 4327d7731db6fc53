"""The sentence that says where a gap lies: the regions that tell most, in an engineer's words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from ces_gap.axes import CURRENT, DIRECTION, ELAPSED, FREQUENCY, HEAT, REVERSAL, SPEED, STROKE
from ces_gap.diagnosis import Region, Where

FALSE_DISCOVERIES = 0.05  # a region counts below this rate
LEAST_SHARE = 0.02  # of the energy that is worth a sentence
LEAST_TOLD = 0.05  # [nats] that regions must tell not to call the gap spread widely
TIME_COUNTS = 0.7  # what time and heat tell, against other axes
WORTH_TWO = 1.2  # two places are named if they tell this many times as much as one
BESIDE = {FREQUENCY: "of the force's"}
SPANS = {  # what comes before, and the factor and the unit of what is shown
    STROKE: ("at strokes", 1e3, "mm"),
    SPEED: ("at speeds", 1.0, "m/s"),
    CURRENT: ("at currents", 1.0, "A"),
    FREQUENCY: ("at frequencies", 1.0, "Hz"),
    ELAPSED: ("at times", 1.0, "s"),
    HEAT: ("at dissipated heats", 1e-3, "kJ"),
}


@dataclass(frozen=True)
class Run:
    """Regions of one axis side by side: what they hold, and whether they reach the axis' ends (`first`, `last`)."""

    axis: str
    low: float
    high: float
    energy: float
    samples: float
    first: bool = False
    last: bool = False


def describe(where: Where) -> str:
    """Return a sentence like "62 % of the gap's energy lies within 20 ms of a reversal (9 % of the time)".

    It is told of regions that exceed the rest of their axis, in one or two places: of frequency only if no other axis
    tells enough, and of time and heat, which grow along with anything, only if they tell clearly more.
    """
    best = {axis: _best(_runs(where.regions, axis)) for axis in dict.fromkeys(r.axis for r in where.regions)}
    found = sorted((runs for runs in best.values() if runs), key=_worth, reverse=True)
    if not found:
        return "The gap lies nowhere in particular: no region has significantly more of it than the rest."
    runs = found[0]
    energy, samples = _percent(sum(r.energy for r in runs)), _percent(sum(r.samples for r in runs))
    lies = f"{_places(runs)} ({samples} {BESIDE.get(runs[0].axis, 'of the time')})"
    if _told(runs) < LEAST_TOLD:
        return f"The gap is spread widely; {energy} of its energy lies {lies}."
    return f"{energy} of the gap's energy lies {lies}."


def place(region: Region) -> str:
    """Return where a region is, in words, such as "at strokes from 20 to 25 mm"."""
    return _places([Run(region.axis, region.low, region.high, region.share_of_energy, region.share_of_samples)])


def _runs(regions: Sequence[Region], axis: str) -> list[Run]:
    """Return every run of significant regions side by side on an axis, but the whole axis."""
    along = sorted((r for r in regions if r.axis == axis), key=lambda r: r.low)
    runs = []
    for a, b in combinations(range(len(along) + 1), 2):
        energy = sum(r.share_of_energy for r in along[a:b])
        if b - a == len(along) or energy < LEAST_SHARE or any(r.q_value > FALSE_DISCOVERIES for r in along[a:b]):
            continue
        samples = sum(r.share_of_samples for r in along[a:b])
        runs.append(Run(axis, along[a].low, along[b - 1].high, energy, samples, a == 0, b == len(along)))
    return runs


def _best(runs: Sequence[Run]) -> list[Run]:
    """Return the run that tells most, or the two apart if they tell much more; none if there is none."""
    single = max(([run] for run in runs), key=_told, default=[])
    pairs = ([a, b] for a, b in permutations(runs, 2) if a.high < b.low)
    pair = max(pairs, key=_told, default=single)
    return pair if pair and _told(pair) > WORTH_TWO * _told(single) else single


def _worth(runs: Sequence[Run]) -> tuple[bool, float]:
    """Return what is told first: what tells enough along an axis other than frequency, and then what tells most."""
    told, axis = _told(runs), runs[0].axis
    return axis != FREQUENCY and told >= LEAST_TOLD, told * (TIME_COUNTS if axis in (ELAPSED, HEAT) else 1.0)


def _told(runs: Sequence[Run]) -> float:
    """Return how much the energy's share tells beyond that of the samples (Kullback-Leibler divergence, nats)."""
    energy, samples = min(sum(r.energy for r in runs), 1.0), sum(r.samples for r in runs)
    pairs = (energy, samples), (1.0 - energy, 1.0 - samples)
    return float(sum(e * np.log(e / max(s, 1e-9)) for e, s in pairs if e > 0.0))


def _places(runs: Sequence[Run]) -> str:
    axis = runs[0].axis
    if axis == DIRECTION:
        return "in compression" if runs[0].low >= 0.0 else "in rebound"
    if axis == REVERSAL:
        return " or ".join(_after(run) for run in runs) + " a reversal"
    before, scale, unit = SPANS[axis]
    return f"{before} {' or '.join(_span(run, lambda v: _number(v * scale)) for run in runs)} {unit}"


def _after(run: Run) -> str:
    if run.low <= 0.0:
        return f"within {_time(run.high)} of"
    return f"later than {_time(run.low)} after" if run.last else f"{_time(run.low)} to {_time(run.high)} after"


def _span(run: Run, number: Callable[[float], str]) -> str:
    if run.first:
        return f"below {number(run.high)}"
    return f"above {number(run.low)}" if run.last else f"from {number(run.low)} to {number(run.high)}"


def _percent(share: float) -> str:
    return (
        f"{100.0 * share:.0f} %" if share >= 0.0095 else f"{100.0 * share:.1g} %" if share >= 0.001 else "under 0.1 %"
    )


def _time(seconds: float) -> str:
    return f"{_number(seconds * 1e3)} ms" if seconds < 1.0 else f"{_number(seconds)} s"


def _number(value: float) -> str:
    return f"{value:.4g}".replace("-", "−")
