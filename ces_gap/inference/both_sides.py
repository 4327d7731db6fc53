"""Both sides as networks: one fitted to the real recordings, and what of it the simulation lacks.

A simulation without dynamics, such as a map of speed and current, lacks several effects. None of them alone explains
much, so that a search which adds one after another never begins. Here the search goes the other way: all parts of the
network that the simulation may lack are there, and each is taken back to the simulation's numbers, the rest refitted,
until only those remain without which the recordings are not explained. What curves of the valves explain is
calibration.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from ces_data.arrays import F, Mask
from ces_gap.baseline.twin import count_steps
from ces_gap.baseline.twin_fit import MAX_TICKS, build_training, fit_network
from ces_gap.effects.refitted import PARTS, NetworkPart, Recalibration
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_from
from ces_gap.trace import Trace
from ces_identify.numerics.levenberg import CentredProblem, descend_about_centre
from ces_identify.physical.models import HydraulicModels

STRENGTH = 0.03  # of the pulls towards usual values
STEPS, STEPS_TO_SIMULATION = 5, 12  # of a refit
ABSENT = 4.0  # of the logarithm of a number, by which it is lowered where the simulation has nothing of the kind
MAX_OWN_COST = 2.0  # [%] of the network on the simulation, above which that is not a damper with dynamics
MIN_PART_SHARE = 0.01  # of the gap's energy on blocks left out, that a part must explain beside the others
MAX_LEFT_SHARE = 0.5  # of the gap's energy: a network that leaves more is none of this damper


def fit_both_sides(evidence: Evidence, threads: int) -> EffectFit | None:
    """Return a recalibration of the simulation and what it lacks; None if a network does not explain the recordings."""
    fitted = fit_network([_with_force(t) for t in evidence.traces], (STRENGTH,), threads, lambda _: None)
    if fitted is None:
        return None
    fit, step_s = fitted
    alike = [t for t in evidence.traces if t.rate_Hz == evidence.traces[0].rate_Hz]
    steps = max(count_steps(t) for t in alike)
    real, _ = build_training([_with_force(t) for t in alike], steps, MAX_TICKS)
    simulated, _ = build_training(alike, steps, MAX_TICKS)
    sides = _Sides.make(replace(fit.models, training=real), simulated.measured, fit.theta)
    if sides.cost(fit.theta) ** 2 > MAX_LEFT_SHARE * sides.gap:
        return None
    kept, theta = sides.eliminate(threads)
    before = sides.take_back(theta, kept)
    models = sides.models.hold_pressures(theta)
    ends = models.body(before), models.body(theta), step_s
    parts = [kind for kind in kept if sides.adds(kind, theta)]
    effects = Recalibration(*ends), *(part(*ends) for part in parts)
    return fit_from(evidence, effects, np.ones(len(effects)))


def _with_force(trace: Trace) -> Trace:
    """Return the trace with the measured force in place of the simulated one."""
    return replace(trace, simulated_at_base=np.interp(trace.base_grid[1], trace.time_s, trace.force))


@dataclass(frozen=True)
class _Sides:
    """Networks on the real recordings: `theta` of those, the simulation's `own` numbers, and the `gap` [%²] to it."""

    models: HydraulicModels
    theta: F
    own: F
    gap: float

    @classmethod
    def make(cls, models: HydraulicModels, simulated: F, theta: F) -> _Sides:
        """Return both sides, the network fitted to the `simulated` force (ticks,) from `theta`."""
        training = models.training
        gap = 1e4 * float(training.selection @ (training.measured - simulated) ** 2)
        of_simulation = replace(models, training=replace(training, measured=simulated))
        owners = np.array(models.layout.owners)
        own = theta - ABSENT * (np.isin(owners, [g for kind in PARTS for g in kind.groups]) & _is_positive(models))
        near = _descend(of_simulation, own, STEPS_TO_SIMULATION, np.ones(len(theta), bool))
        scale = training.scale_N / max(float(simulated.std()), 1e-9)
        if of_simulation.cost(near, training.selection) * scale < MAX_OWN_COST:
            own = near
        return cls(models, theta, own, gap)

    def cost(self, theta: F) -> float:
        """Return the cost [%] on blocks left out."""
        return self.models.cost(theta, self.models.training.selection)

    def take_back(self, theta: F, parts: Sequence[type[NetworkPart]]) -> F:
        """Return theta with the numbers of some parts as in the simulation."""
        return np.where(self._places(parts), self.own, theta)

    def adds(self, part: type[NetworkPart], theta: F) -> bool:
        """Return whether theta has more of a part than the simulation."""
        return bool((theta - self.own)[self._places((part,)) & _is_positive(self.models)].sum() > 0.0)

    def eliminate(self, threads: int) -> tuple[list[type[NetworkPart]], F]:
        """Return the parts that are needed beside the others, and theta without the rest."""
        theta = self._without(self.theta, ())
        with ThreadPoolExecutor(max(1, threads)) as pool:
            costs = list(pool.map(lambda part: self.cost(self._without(theta, (part,))), PARTS))
        weakest_first = [PARTS[k] for k in np.argsort(costs)]
        gone: list[type[NetworkPart]] = []
        for part in weakest_first:
            fewer = self._without(theta, (*gone, part))
            if self.cost(fewer) ** 2 - self.cost(theta) ** 2 < MIN_PART_SHARE * self.gap:
                gone, theta = [*gone, part], fewer
        return [part for part in reversed(weakest_first) if part not in gone], theta

    def _without(self, theta: F, parts: Sequence[type[NetworkPart]]) -> F:
        return _descend(self.models, self.take_back(theta, parts), STEPS, ~self._places(parts))

    def _places(self, parts: Sequence[type[NetworkPart]]) -> Mask:
        groups = [group for part in parts for group in part.groups]
        return np.isin(np.array(self.models.layout.owners), groups)


def _is_positive(models: HydraulicModels) -> Mask:
    """Return which entries of theta are logarithms."""
    signed = [group.name for group in models.layout.groups if group.unit is not None]
    return ~np.isin(np.array(models.layout.owners), signed)


def _descend(models: HydraulicModels, start: F, steps: int, free: Mask) -> F:
    """Return theta after some steps of its `free` entries on the estimation ticks."""
    weights = models.training.estimation

    def embed(values: F) -> F:
        theta = start.copy()
        theta[free] = values
        return theta

    def equations(values: F) -> tuple[float, F, F]:
        error, matrix, gradient = models.normal_equations(embed(values), weights)
        return error, matrix[np.ix_(free, free)], gradient[free]

    problem = CentredProblem(
        lambda values: models.error(embed(values), weights),
        equations,
        STRENGTH * models.layout.weight[free],
        start[free],
    )
    found = [values for _, values in islice(descend_about_centre(problem, start[free]), steps)]
    return embed(found[-1]) if found else start
