"""The witness: each parameter group of a physical baseline refitted to the real recordings, judged on held-out ones.

It shares nothing with the library's effects: a group that had to move, and closes the gap by moving, speaks for an
effect of its kind. The same refit on the references, where nothing may move, is the control.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ces_gap.inference.learn_baseline import Baseline
from ces_gap.intake.operating_range import model_inside
from ces_gap.intake.prepare import DiagnosisInput
from ces_gap.progress import Progress, ignore_progress
from ces_gap.trace import F
from ces_gap.witness.groups import GROUPS, ParameterGroup
from ces_gap.witness.refit import (
    Linearisation,
    compare_movements,
    linearise,
    measure_movement,
    places_of,
    refit_group,
)
from ces_gap.witness.target import RefitTarget, build_target
from ces_identify.simulations.simulation import Simulation
from ces_identify.structures.physical_quantities import Body, read_quantities
from ces_observer.errors import CesError
from ces_observer.model import Model
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.relaxation import Relaxation

MIN_PREDICTED_GAIN = 0.01  # of the squared error: a group that could gain less is not refitted
MAX_CHANGES, MIN_CHANGE = 2, 0.02  # quantities that a report names, and the relative change from which it does


@dataclass(frozen=True)
class QuantityChange:
    """A quantity of the damper by its name, which holds the unit, before and after a refit."""

    name: str
    before: float
    after: float


@dataclass(frozen=True)
class GroupRefit:
    """The refit of one group: it moved by `moved_z` standard errors, in the references' refit by `control_z` (or None).

    `closes` is the share of the held-out gap (RMS, noise taken out) that it closes, `energy` and `energy_error` the
    share of the gap's energy and its standard error. `block_energy` (b,) are the parts of `energy` in blocks.
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
class Witness:
    """The refits of all groups, the one that closes most first; `note` says why there are none."""

    refits: tuple[GroupRefit, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class _Targets:
    """The baseline on the recordings to fit, those held out, and the references (None without any)."""

    model: Model
    real: RefitTarget
    held_out: RefitTarget
    control: RefitTarget | None


def ask_witness(
    simulation: Simulation, inputs: DiagnosisInput, baseline: Baseline, progress: Progress = ignore_progress
) -> Witness | None:
    """Return the refits of a baseline that is a physical model, None for any other simulation.

    It never fails: what goes wrong is the witness' note.
    """
    model = model_inside(simulation)
    if model is None or not isinstance(model.body, Relaxation | Chambers):
        return None
    try:
        targets = _open(model, model.body, inputs, baseline)
        if targets is None:
            return Witness(note="the model's parameters cannot be refitted: its nodes are not those of this version")
        return Witness(tuple(_refit_all(targets, baseline.evidence.noise.rms_N, progress)))
    except (CesError, ArithmeticError, np.linalg.LinAlgError, ValueError) as error:
        return Witness(note=f"the model's parameters could not be refitted: {error}")


def _open(model: Model, body: Body, inputs: DiagnosisInput, baseline: Baseline) -> _Targets | None:
    roles = (inputs.real, inputs.held_out, inputs.reference)
    opened = [build_target(model, body, traces, baseline.correction) if traces else None for traces in roles]
    real, held_out, control = opened
    return None if real is None or held_out is None else _Targets(model, real, held_out, control)


def _refit_all(targets: _Targets, noise_N: float, progress: Progress) -> Sequence[GroupRefit]:
    real, control = targets.real, targets.control
    start = linearise(real, real.theta)
    quiet = None if control is None else linearise(control, control.theta)
    before = targets.held_out.square_errors(targets.held_out.theta)
    found = []
    for k, group in enumerate(GROUPS):
        progress(f"refitting the model's {group.name}", k / len(GROUPS))
        free = places_of(real, group.parts)
        free = free[np.diag(start.matrix)[free] > 0.0]
        if len(free) and _predict_gain(real, free, start) > MIN_PREDICTED_GAIN:
            found.append(_refit_one(targets, group, free, quiet, before, noise_N))
    return sorted(found, key=lambda refit: -refit.energy)


def _predict_gain(target: RefitTarget, free: np.ndarray, at: Linearisation) -> float:
    """Return the share of the squared error that one step of the group's parameters would gain."""
    gradient, matrix = at.gradients.sum(axis=0)[free], at.matrix[np.ix_(free, free)]
    gain = float(gradient @ np.linalg.lstsq(matrix, gradient, rcond=1e-9)[0])
    return gain / max(target.models.error(target.theta, target.weights), 1e-300)


def _refit_one(
    targets: _Targets,
    group: ParameterGroup,
    free: np.ndarray,
    quiet: Linearisation | None,
    before: F,
    noise_N: float,
) -> GroupRefit:
    real, held_out, control = targets.real, targets.held_out, targets.control
    theta = refit_group(real, free)
    moved = measure_movement(real, free, linearise(real, theta), theta[free] - real.theta[free])
    rest = None
    if control is not None and quiet is not None:
        rest = measure_movement(control, free, quiet, np.zeros(len(free)))
    gap = max(float(before.sum()) - held_out.count * noise_N**2, 1e-9 * float(before.sum()) + 1e-300)
    gain = (before - held_out.square_errors(theta)) / gap
    energy = float(gain.sum())
    return GroupRefit(
        group.name,
        group.effects,
        compare_movements(moved, rest),
        None if rest is None else compare_movements(rest, None),
        float(1.0 - np.sqrt(max(1.0 - energy, 0.0))),
        energy,
        float(np.sqrt(len(gain)) * gain.std()),
        _describe_changes(targets, theta),
        tuple(gain.tolist()),
    )


def _describe_changes(targets: _Targets, theta: F) -> tuple[QuantityChange, ...]:
    """Return the quantities that change most by a refit, relative to their size."""

    def read(at: F) -> Mapping[str, float]:
        body = targets.real.models.body(at)
        return read_quantities(body, 1.0 / targets.model.sampling.rate_Hz, targets.model.envelope.position_m)

    old, new = read(targets.real.theta), read(theta)
    relative = {name: abs(new[name] - old[name]) / max(abs(old[name]), abs(new[name]), 1e-300) for name in old}
    largest = sorted((n for n in old if relative[n] > MIN_CHANGE), key=lambda name: -relative[name])
    return tuple(QuantityChange(name, old[name], new[name]) for name in largest[:MAX_CHANGES])
