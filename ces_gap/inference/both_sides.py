"""Both sides of a gap as networks: one fitted to the real recordings, and what of it a static map lacks.

A map of speed and current lacks several effects at once. None of them alone explains much, so that a search which adds
one after another never begins. Here the search goes the other way: all parts of a network that a map cannot have are
there, and each is taken out, the rest refitted, until only those remain without which the recordings are not explained.
What the curves of the valves explain is calibration.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from scipy.spatial import cKDTree

from ces_data.arrays import F, Mask
from ces_gap.baseline.twin import count_steps
from ces_gap.baseline.twin_fit import MAX_TICKS, build_training, fit_network
from ces_gap.effects.effect import Effect
from ces_gap.effects.refitted import PARTS, NetworkPart, Recalibration
from ces_gap.effects.simulation_errors import CALIBRATION_FORMS
from ces_gap.grid import rms
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_from
from ces_gap.limits import SearchLimits, VerdictLimits
from ces_gap.progress import Progress
from ces_gap.trace import Trace, usable_inputs, usable_values
from ces_identify.numerics.least_squares import NormalEquations, check_error_first, improve, pull_towards
from ces_identify.physical.models import HydraulicModels

WEIGHTS = 0.3, 1.0, 1.0  # of stroke, speed and current in a distance: a gas spring is soft
MOMENTS, NEIGHBOURS, APART_S, NEAR = 4000, 60, 0.15, 0.1  # compared moments; NEAR is a distance
STRENGTH = 0.03  # of the pulls towards usual values
STEPS, END_STEPS = 5, 40  # of a refit, and of those between which the answer is chosen
ABSENT = 5.0  # by which the logarithm of a number is lowered where there is nothing of the kind


def explain_static_map(
    evidence: Evidence, single: EffectFit, energy: float, effects: Sequence[Effect], threads: int, progress: Progress
) -> EffectFit | None:
    """Return what a network of the recordings has and a static map lacks, where the `single` effect leaves much.

    None for other simulations, and with references (no calibration among the `effects`): they have shown its error.
    """
    much = single.cost - len(single.residual) > VerdictLimits.TENTH * energy
    corrected = not any(e in CALIBRATION_FORMS for e in effects)
    if not much or corrected or evidence.plants[0].twin is None or not is_static(evidence.traces):
        return None
    progress("fitting a network to the real recordings", 0.0)
    names = {e.name for e in effects}
    network = fit_both_sides(evidence, [part for part in PARTS if part.name in names], threads)
    rest = np.inf if network is None else network.cost - len(network.residual)
    return network if rest < VerdictLimits.TENTH * energy else None


def fit_both_sides(evidence: Evidence, kinds: Sequence[type[NetworkPart]], threads: int) -> EffectFit | None:
    """Return a recalibration of a static map, and what it lacks of some kinds of parts; None without a network."""
    real = [_with_force(t) for t in evidence.traces]
    network = fit_network(real, (STRENGTH,), threads, lambda _: None)
    if network is None:
        return None
    fit, step_s = network
    alike = [t for t in real if t.rate_Hz == real[0].rate_Hz]
    training, _ = build_training(alike, max(count_steps(t) for t in alike), MAX_TICKS)
    error = usable_values(evidence.traces, [t.force - t.simulated for t in evidence.traces])
    gap = (100.0 * rms(error) / training.scale_N) ** 2
    parts, theta = _Network(replace(fit.models, training=training), gap).eliminate(fit.theta, kinds, threads)
    models = fit.models.hold_pressures(theta)
    ends = models.body(_take_out(models, theta, parts)), models.body(theta), step_s
    effects = Recalibration(*ends), *(part(*ends) for part in parts)
    return fit_from(evidence, effects, np.ones(len(effects)))


def is_static(traces: Sequence[Trace]) -> bool:
    """Return whether the simulated force follows from stroke, speed and current alone.

    It is compared with itself at the nearest moment of another time. Hydraulic dampers differ there by 15 to 60 % of
    the force's standard deviation, a table behind a spring by 2 to 16, maps by 2 (false nearest neighbours: Rhodes and
    Morari, AIChE Journal 44, 1998).
    """
    force = usable_values(traces, [t.simulated for t in traces])
    axes = [usable_inputs(traces, name) for name in ("position", "speed", "current")]
    at = np.column_stack([share * x / max(float(x.std()), 1e-9) for share, x in zip(WEIGHTS, axes, strict=True)])
    ends = np.cumsum([0.0, *(t.time_s[-1] + APART_S for t in traces[:-1])])
    time_s = usable_values(traces, [t.time_s + end for t, end in zip(traces, ends, strict=True)])
    chosen = np.linspace(0, len(force) - 1, min(MOMENTS, len(force))).astype(np.int64)
    distance, near = cKDTree(at).query(at[chosen], min(NEIGHBOURS, len(force)))
    valid = (np.abs(time_s[near] - time_s[chosen, None]) > APART_S) & (distance < NEAR)
    pairs = np.column_stack([near[np.arange(len(chosen)), valid.argmax(axis=1)], chosen])[valid.any(axis=1)]
    difference = force[pairs[:, 0]] - force[pairs[:, 1]]
    most_N = np.sqrt(2.0) * SearchLimits.MAX_STATIC * float(force.std())
    return len(pairs) > 0.5 * len(chosen) and rms(difference) < most_N


def _with_force(trace: Trace) -> Trace:
    """Return the trace with the measured force in place of the simulated one."""
    return replace(trace, simulated_at_base=np.interp(trace.base_grid[1], trace.time_s, trace.force))


@dataclass(frozen=True)
class _Network:
    """Networks of the real recordings, whose difference from the simulation is the `gap` (%²)."""

    models: HydraulicModels
    gap: float

    def eliminate(
        self, theta: F, kinds: Sequence[type[NetworkPart]], threads: int
    ) -> tuple[list[type[NetworkPart]], F]:
        """Return the parts that are needed beside the others, and theta without the rest, the others refitted.

        Parts of other `kinds` are not there.
        """
        absent: list[type[NetworkPart]] = [part for part in PARTS if part not in kinds]
        theta = whole = self._without(theta, absent)
        gone = list(absent)
        with ThreadPoolExecutor(max(1, threads)) as pool:
            costs = list(pool.map(lambda part: self._cost(self._without(theta, (*absent, part))), kinds))
        weakest_first = [kinds[k] for k in np.argsort(costs)]
        for part in weakest_first:
            fewer = self._without(theta, (*gone, part))
            if self._cost(fewer) ** 2 - self._cost(theta) ** 2 < SearchLimits.MIN_PART * self.gap:
                gone, theta = [*gone, part], fewer
        kept = [part for part in reversed(weakest_first) if part not in gone]
        for place in range(len(kept)):
            kept, theta = self._exchange(kept, place, kinds, whole, theta)
        return kept, theta

    def _exchange(
        self, kept: list[type[NetworkPart]], place: int, kinds: Sequence[type[NetworkPart]], whole: F, theta: F
    ) -> tuple[list[type[NetworkPart]], F]:
        """Return the parts with that at `place` replaced by one that was taken out, where this explains more.

        Of two springs in series with the motion either can go first while the other is there; alone they differ.
        """
        missing = [part for part in kinds if part not in kept]
        ways = [kept, *([*kept[:place], part, *kept[place + 1 :]] for part in missing)]
        starts = [theta, *(self._without(whole, self._others(way)) for way in ways[1:])]
        enough = self._cost(theta) ** 2 + SearchLimits.MIN_PART * self.gap
        close = [k for k, start in enumerate(starts) if self._cost(start) ** 2 < enough]
        if close == [0]:
            return kept, theta
        ends = [
            _descend(self.models, starts[k], END_STEPS, ~_places(self.models, self._others(ways[k]))) for k in close
        ]
        best = int(np.argmin([self._cost(end) for end in ends]))
        return ways[close[best]], ends[best]

    def _others(self, parts: Sequence[type[NetworkPart]]) -> list[type[NetworkPart]]:
        return [part for part in PARTS if part not in parts]

    def _cost(self, theta: F) -> float:
        return self.models.cost(theta, self.models.training.selection)

    def _without(self, theta: F, parts: Sequence[type[NetworkPart]], steps: int = STEPS) -> F:
        return _descend(self.models, _take_out(self.models, theta, parts), steps, ~_places(self.models, parts))


def _take_out(models: HydraulicModels, theta: F, parts: Sequence[type[NetworkPart]]) -> F:
    """Return theta with next to nothing of some parts: their logarithms are lowered."""
    signed = [group.name for group in models.layout.groups if group.unit is not None]
    return theta - ABSENT * (_places(models, parts) & ~np.isin(models.layout.owners, signed))


def _places(models: HydraulicModels, parts: Sequence[type[NetworkPart]]) -> Mask:
    return np.isin(models.layout.owners, [group for part in parts for group in part.groups])


def _descend(models: HydraulicModels, start: F, steps: int, free: Mask) -> F:
    """Return theta after some steps of its `free` entries on the estimation ticks."""
    weights = models.training.estimation

    def embed(values: F) -> F:
        theta = start.copy()
        theta[free] = values
        return theta

    def differentiate(values: F) -> NormalEquations:
        error, matrix, gradient = models.normal_equations(embed(values), weights)
        return NormalEquations(error, matrix[np.ix_(free, free)], gradient[free])

    equations = check_error_first(lambda values: models.error(embed(values), weights), differentiate)
    pull = pull_towards(start[free], STRENGTH * models.layout.weight[free])
    points = list(islice(improve(equations, start[free], [pull]), 1 + steps))
    return embed(points[-1].params) if points else start
