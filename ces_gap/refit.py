"""Second check of a diagnosis: the parameters of a physical model refitted to the real recordings, group by group.

Effects are added around the simulation; the refits change the simulation itself. A group that moves, on recordings that
neither fit has seen, agrees with an effect that would move it, or contradicts the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F
from ces_gap.baseline.identified import IdentifiedBaseline
from ces_gap.baseline.learner import LearnedCorrection
from ces_gap.effects.library import library
from ces_gap.effects.simulation_errors import simulation_errors
from ces_gap.errors import GapError
from ces_gap.grid import number_blocks
from ces_gap.inference.evidence import Baseline
from ces_gap.inference.verdict import AMBIGUOUS, NAMED
from ces_gap.inputs.prepare import DiagnosisInput
from ces_gap.progress import FAILURES, Progress, ignore_progress
from ces_gap.trace import Trace
from ces_identify.numerics.levenberg import CentredProblem, descend_about_centre
from ces_identify.physical.models import HydraulicModels
from ces_identify.physical.quantities import read_quantities
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.trained.training import Training
from ces_observer.model import Model
from ces_observer.structures.hydraulic import Hydraulic
from ces_report.typesetting import format_range

BLOCK_S = 0.5  # [s] errors within a block count as one sample in standard errors
MAX_TICKS = 40_000  # of the fitted recordings: the first part of each
MAX_STEPS = 4
PULL = 1e-9  # weight of a squared change of a parameter, which holds what the recordings do not determine
MIN_PREDICTED_GAIN = 0.01  # of the squared error: a group that could gain less is not refitted
MIN_GAP = 0.1  # of the noise's energy: a smaller held-out gap counts as this large
MAX_CHANGES, MIN_CHANGE = 2, 0.02  # quantities that a report names, and the relative change from which it does
MIN_MOVED = 3.0  # standard errors
MIN_ENERGY = 0.1  # of the held-out gap, for a refit that counts
CLEAR_Z = 2.0  # standard errors by which a refit closes more than another
CLEAR_ENERGY = 0.1  # of the gap, too

GROUPS: Mapping[str, tuple[str, ...]] = {  # parts of a model's layout, by the name that reports give them
    "elasticity": ("compression", "rebound", "compression_growth", "rebound_growth", "mount", "creep", "air"),
    "friction": ("viscous_Ns_m", "friction", "friction_yield", "friction_moved", "growth"),
    "gas force": ("gas_N",),
    "valve lag": ("rise_s", "fall_s", "delay_ticks"),
    "magnetic loop": ("hysteresis_A",),
    "valve characteristic": ("setting",),  # ends at the extreme currents: a gain of the current moves the map, too
    "lead of the drive": ("lead_s",),
    "moving mass": ("mass_kg",),
    "refilling": ("base", "reservoir", "closing_s"),
    "flow map": ("piston", "external", "bypass", "narrow_N", "fade_1_W", "ratio"),
}
Places = NDArray[np.int64]


@cache
def effects_of(group: str) -> tuple[str, ...]:
    """Return the effects that would move a group, by what they say of themselves (`Effect.moves`)."""
    return tuple(dict.fromkeys(e.name for e in (*library(), *simulation_errors()) if group in e.moves))


@dataclass(frozen=True)
class QuantityChange:
    """A quantity of the damper by its name, which holds the unit, before and after a refit."""

    name: str
    before: float
    after: float


@dataclass(frozen=True)
class GroupRefit:
    """The refit of one group.

    Held-out recordings ask for its change of force by `moved_z` standard errors, net of what the references ask for,
    `control_z` standard errors (None without references). `closes` is the share of the held-out gap (RMS, noise taken
    out) that it closes, `energy` and `energy_error` the share of the gap's energy and its standard error;
    `block_energy` (b,) are the parts of `energy` in blocks.
    """

    group: str
    effects: tuple[str, ...]
    moved_z: float
    control_z: float | None
    closes: float
    energy: float
    energy_error: float
    changes: tuple[QuantityChange, ...]
    block_energy: tuple[float, ...] = ()


@dataclass(frozen=True)
class ModelRefits:
    """The refits of the groups that could gain anything, the one that closes most first.

    `group_effects` are the effects of every group that the model has, refitted or not; `note` says why there are none.
    """

    refits: tuple[GroupRefit, ...] = ()
    group_effects: tuple[tuple[str, ...], ...] = ()
    note: str = ""


def refit_physical_model(
    simulation: Simulation, inputs: DiagnosisInput, baseline: Baseline, progress: Progress = ignore_progress
) -> ModelRefits | None:
    """Return the refits of a baseline that is a physical model, None for any other simulation.

    The diagnosis is complete without them: recordings or numbers that prevent them become their note.
    """
    if not isinstance(simulation, ModelSimulation | IdentifiedBaseline):
        return None
    model, noise_N = simulation.model, baseline.evidence.noise.rms_N
    if not isinstance(model.body, Hydraulic):
        return None
    try:
        roles = (inputs.real, inputs.held_out, inputs.reference)
        real, held_out, control = (
            build_target(model, model.body, traces, baseline.correction) if traces else None for traces in roles
        )
        if real is None or held_out is None:
            return ModelRefits(note="the model's parameters cannot be refitted without held-out recordings")
        groups = [group for group in GROUPS if len(real.places(group))]
        _, matrix, gradient = real.models.normal_equations(real.theta, real.weights)
        found = []
        for k, group in enumerate(groups):
            progress(f"refitting the model's {group}", k / len(groups))
            free = real.places(group)
            free = free[np.diag(matrix)[free] > 0.0]
            if len(free) and predict_gain(real, free, matrix, gradient) > MIN_PREDICTED_GAIN:
                theta = refit_group(real, free)
                found.append(evaluate_refit(group, theta, held_out, control, noise_N, find_changes(model, real, theta)))
    except FAILURES as error:
        return ModelRefits(note=f"the model's parameters could not be refitted: {type(error).__name__}: {error}")
    refits = sorted(found, key=lambda refit: -refit.energy)
    return ModelRefits(tuple(refits), tuple(effects_of(group) for group in groups))


@dataclass(frozen=True)
class RefitTarget:
    """Models on the nodes of a baseline, its parameters `theta`, weights (ticks,) and blocks (ticks,) of the data."""

    models: HydraulicModels
    theta: F
    weights: F
    blocks: NDArray[np.int64]

    def square_errors(self, theta: F) -> F:
        """Return the sum of the squared errors [N2] in each block (b,)."""
        error = np.where(self.weights > 0.0, self.models.force(theta) - self.models.training.measured, 0.0)
        return np.asarray(np.bincount(self.blocks, error**2), np.float64)

    def places(self, group: str) -> Places:
        """Return the places in theta of those parts of a group that the model has."""
        return np.flatnonzero(np.isin(self.models.layout.owners, GROUPS[group]))


def build_target(
    model: Model, body: Hydraulic, traces: Sequence[Trace], correction: LearnedCorrection | None
) -> RefitTarget:
    """Return the target on the usable ticks of the traces; raises GapError without any."""
    series = [prepare(trace.recording, model.sampling) for trace in traces]
    share = min(1.0, MAX_TICKS / max(1, sum(len(one) for one in series)))
    series = [one.part(0.0, share) for one in series]
    keep, measured = [], []
    for one, trace in zip(series, traces, strict=True):
        usable = np.interp(one.time_s, trace.time_s, trace.usable) > 0.99
        keep.append(one.scored & usable)
        added = 0.0 if correction is None else correction.force(trace, trace.inputs, trace.simulated)
        measured.append(one.force - np.interp(one.time_s, trace.time_s, np.zeros(len(trace)) + added))
    mask, force = np.concatenate(keep), np.concatenate(measured)
    if not mask.any():
        raise GapError(f"{', '.join(t.name for t in traces)}: no usable tick after the model's warm-up")
    starts = np.cumsum([0, *(len(s) for s in series[:-1])])
    segments = np.concatenate([s.segments + at for s, at in zip(series, starts, strict=True)])
    spread = float(force[mask].std())
    weights: F = np.where(mask, 1.0 / (mask.sum() * spread**2), 0.0)
    training = Training(
        inputs=np.stack([np.concatenate([getattr(s, n) for s in series]) for n in ("position", "speed", "current")]),
        measured=np.where(mask, force, 0.0),
        segments=np.ascontiguousarray(segments, np.int64),
        recordings=np.repeat(np.arange(len(series)), [len(s.segments) for s in series]),
        estimation=weights,
        selection=np.zeros_like(weights),
        envelope=model.envelope,
        force_envelope=model.force_envelope_N,
        scale_N=spread,
    )
    blocks = np.concatenate(number_blocks([one.time_s for one in series], BLOCK_S))
    return RefitTarget(*HydraulicModels.reopen(body, 1.0 / model.sampling.rate_Hz, training), weights, blocks)


def predict_gain(target: RefitTarget, free: Places, matrix: F, gradient: F) -> float:
    """Return the share of the squared error that one step of the parameters at the places `free` would gain.

    `matrix` (n, n) and `gradient` (n,) are those of half the squared error by all parameters.
    """
    step = np.linalg.lstsq(matrix[np.ix_(free, free)], gradient[free], rcond=1e-9)[0]
    return float(gradient[free] @ step) / max(target.models.error(target.theta, target.weights), 1e-300)


def refit_group(target: RefitTarget, free: Places) -> F:
    """Return theta with the parameters at the places `free` refitted."""
    start = target.theta

    def embed(values: F) -> F:
        theta = start.copy()
        theta[free] = values
        return theta

    def equations(values: F) -> tuple[float, F, F]:
        error, matrix, gradient = target.models.normal_equations(embed(values), target.weights)
        return error, matrix[np.ix_(free, free)], gradient[free]

    problem = CentredProblem(
        lambda values: target.models.error(embed(values), target.weights),
        equations,
        np.full(len(free), PULL),
        start[free],
    )
    theta = start
    for _, values in islice(descend_about_centre(problem, start[free]), MAX_STEPS):
        theta = embed(values)
    return theta


def evaluate_refit(
    group: str,
    theta: F,
    held_out: RefitTarget,
    control: RefitTarget | None,
    noise_N: float,
    changes: tuple[QuantityChange, ...],
) -> GroupRefit:
    """Return what held-out recordings, and the references as a `control`, say of a group refitted to `theta`."""
    asked, error = measure_amplitude(held_out, theta)
    moved_z, control_z = asked / max(error, 1e-12), None
    if control is not None:
        unasked, control_error = measure_amplitude(control, theta)
        moved_z = (asked - unasked) / max(float(np.hypot(error, control_error)), 1e-12)
        control_z = unasked / max(control_error, 1e-12)
    noise, before = int((held_out.weights > 0.0).sum()) * noise_N**2, held_out.square_errors(held_out.theta)
    gain = (before - held_out.square_errors(theta)) / max(float(before.sum()) - noise, MIN_GAP * noise, 1e-12)
    energy = float(gain.sum())
    return GroupRefit(
        group=group,
        effects=effects_of(group),
        moved_z=moved_z,
        control_z=control_z,
        closes=float(1.0 - np.sqrt(max(1.0 - energy, 0.0))),
        energy=energy,
        energy_error=float(np.sqrt(len(gain)) * gain.std()),
        changes=changes,
        block_energy=tuple(gain.tolist()),
    )


def measure_amplitude(target: RefitTarget, theta: F) -> tuple[float, float]:
    """Return the share of the change of force from the baseline to `theta` that the recordings ask for (1: all of it).

    It is the regression of the baseline's error on the change; each block counts as one sample in its standard error,
    which follows (White, Econometrica 50, 1982).
    """
    before = target.models.force(target.theta)
    change = np.where(target.weights > 0.0, target.models.force(theta) - before, 0.0)
    size = max(float(change @ change), 1e-300)
    value = float(change @ (target.models.training.measured - before)) / size
    rest = change * (target.models.training.measured - before - value * change)
    scores = np.bincount(target.blocks, rest)
    used = np.bincount(target.blocks, target.weights) > 0.0
    spare = max(int(used.sum()) - 1, 1)
    return value, float(np.sqrt((scores[used] ** 2).sum() * used.sum() / spare)) / size


def find_changes(model: Model, target: RefitTarget, theta: F) -> tuple[QuantityChange, ...]:
    """Return the quantities that change most from the baseline to `theta`, relative to their size."""
    models, interval_s, stroke = target.models, 1.0 / model.sampling.rate_Hz, model.envelope.position_m
    old, new = (read_quantities(models.body(at), interval_s, stroke) for at in (target.theta, theta))
    relative = {name: abs(new[name] - old[name]) / max(abs(old[name]), abs(new[name]), 1e-300) for name in old}
    largest = sorted((n for n in old if relative[n] > MIN_CHANGE), key=lambda name: -relative[name])
    return tuple(QuantityChange(name, old[name], new[name]) for name in largest[:MAX_CHANGES])


def find_contradiction(composition: Sequence[str], found: ModelRefits | None) -> GroupRefit | None:
    """Return the refit that closes clearly more than those of the effects in the composition; None if none does.

    A model without a group for any of the effects says nothing, nor do refits without a control, as the model's own
    error moves its parameters, too.
    """
    if found is None or not any(set(effects) & set(composition) for effects in found.group_effects):
        return None
    own = _find_own(composition, found)
    others = [r for r in found.refits if r.control_z is not None and not set(r.effects) & set(composition)]
    better = [refit for refit in others if has_moved(refit) and closes_more(refit, own)]
    return max(better, key=lambda refit: refit.energy, default=None)


def describe_refits(verdict: str, composition: Sequence[str], found: ModelRefits | None) -> str:
    """Return what the refits say of the effects in the composition, "" if nothing.

    Where the verdict is on no effect, they say which group moved.
    """
    if found is None or verdict not in (NAMED, AMBIGUOUS):
        refits = () if found is None else found.refits
        first = next((refit for refit in refits if refit.control_z is not None and has_moved(refit)), None)
        return "" if first is None else f"the model's {first.group} moved: {describe_refit(first)}"
    own, most = _find_own(composition, found), find_contradiction(composition, found)
    if most is not None:
        text = f"a refit of the model's {most.group} explains more: {describe_refit(most)}"
        return text if own is None else f"{text}, that of its {own.group} {own.closes:.0%}"
    agrees = own is not None and has_moved(own)
    return f"the refit of the model's {own.group} agrees: {describe_refit(own)}" if own is not None and agrees else ""


def _find_own(composition: Sequence[str], found: ModelRefits) -> GroupRefit | None:
    """Return the refit with a control that closes most of those that belong to the effects in the composition."""
    own = [r for r in found.refits if r.control_z is not None and set(r.effects) & set(composition)]
    return max(own, key=lambda refit: refit.energy, default=None)


def has_moved(refit: GroupRefit) -> bool:
    """True if the group moved, more than on the references, and closes part of the held-out gap by it."""
    clear = refit.energy > CLEAR_Z * refit.energy_error and refit.energy >= MIN_ENERGY
    return clear and refit.moved_z >= max(MIN_MOVED, abs(refit.control_z or 0.0))


def closes_more(refit: GroupRefit, other: GroupRefit | None) -> bool:
    """True if a refit closes more of the held-out gap than another one, beyond the error of the difference."""
    if other is None:
        return True
    difference = np.array(refit.block_energy) - np.array(other.block_energy)
    error = float(np.sqrt(len(difference)) * difference.std())
    return float(difference.sum()) > max(CLEAR_ENERGY, CLEAR_Z * error)


def describe_refit(refit: GroupRefit) -> str:
    """Return how a group moved, by how many standard errors, and what it closes."""
    changes = []
    for change in refit.changes:
        name, _, unit = change.name.partition(" [")
        values = f"{format_range(change.before, change.after)} {unit.rstrip(']')}".rstrip()
        changes.append(f"{name[0].lower()}{name[1:]} {values}")
    control = "" if refit.control_z is None else f" ({refit.control_z:.0f} on the references)"
    moved = f"{refit.moved_z:.0f} standard errors{control}"
    return ", ".join([*changes, moved, f"closes {refit.closes:.0%} of the held-out gap"])
