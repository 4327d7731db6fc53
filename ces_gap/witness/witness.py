"""The witness: each parameter group of a physical baseline refitted to the real recordings, judged on held-out ones.

It shares nothing with the library's effects: a group that had to move, and closes the gap by moving, speaks for an
effect of its kind. The same refit on the references, where nothing may move, is the control.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ces_gap.baseline.identified import IdentifiedBaseline
from ces_gap.inference.learn_baseline import Baseline
from ces_gap.intake.prepare import DiagnosisInput
from ces_gap.progress import Progress, ignore_progress
from ces_gap.trace import F
from ces_gap.witness.groups import GROUPS, ParameterGroup
from ces_gap.witness.refit import (
    Places,
    measure_amplitude,
    places_of,
    predict_gain,
    refit_group,
    subtract_control,
)
from ces_gap.witness.target import RefitTarget, build_target
from ces_identify.physical.models import Body
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.structures.physical_quantities import read_quantities
from ces_observer.model import Model
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.relaxation import Relaxation

MIN_PREDICTED_GAIN = 0.01  # of the squared error: a group that could gain less is not refitted
MIN_GAP = 0.1  # of the noise's energy: a smaller held-out gap counts as this large
MAX_CHANGES, MIN_CHANGE = 2, 0.02  # quantities that a report names, and the relative change from which it does


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
class Witness:
    """The refits of the groups that could gain anything, the one that closes most first.

    `heard` are the effects of every group that the model has, refitted or not; `note` says why there are none.
    """

    refits: tuple[GroupRefit, ...] = ()
    heard: tuple[tuple[str, ...], ...] = ()
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
    if not isinstance(simulation, ModelSimulation | IdentifiedBaseline):
        return None
    model = simulation.model
    if not isinstance(model.body, Relaxation | Chambers):
        return None
    try:
        targets = _open(model, model.body, inputs, baseline)
        if targets is None:
            return Witness(note="the model's parameters cannot be refitted: its nodes are not those of this version")
        groups = [g for g in GROUPS if len(places_of(targets.real, g.parts))]
        refits = _refit_all(targets, groups, baseline.evidence.noise.rms_N, progress)
        return Witness(tuple(refits), tuple(g.effects for g in groups))
    except Exception as error:  # the diagnosis is complete without it
        return Witness(note=f"the model's parameters could not be refitted: {type(error).__name__}: {error}")


def _open(model: Model, body: Body, inputs: DiagnosisInput, baseline: Baseline) -> _Targets | None:
    roles = (inputs.real, inputs.held_out, inputs.reference)
    opened = [build_target(model, body, traces, baseline.correction) if traces else None for traces in roles]
    real, held_out, control = opened
    return None if real is None or held_out is None else _Targets(model, real, held_out, control)


def _refit_all(
    targets: _Targets, groups: Sequence[ParameterGroup], noise_N: float, progress: Progress
) -> Sequence[GroupRefit]:
    real = targets.real
    _, matrix, gradient = real.models.normal_equations(real.theta, real.weights)
    before = targets.held_out.square_errors(targets.held_out.theta)
    found = []
    for k, group in enumerate(groups):
        progress(f"refitting the model's {group.name}", k / len(groups))
        free = places_of(real, group.parts)
        free = free[np.diag(matrix)[free] > 0.0]
        if len(free) and predict_gain(real, free, matrix, gradient) > MIN_PREDICTED_GAIN:
            found.append(_refit_one(targets, group, free, before, noise_N))
    return sorted(found, key=lambda refit: -refit.energy)


def _refit_one(targets: _Targets, group: ParameterGroup, free: Places, before: F, noise_N: float) -> GroupRefit:
    held_out, theta = targets.held_out, refit_group(targets.real, free)
    asked = measure_amplitude(held_out, theta)
    control = None if targets.control is None else measure_amplitude(targets.control, theta)
    noise = held_out.count * noise_N**2
    gain = (before - held_out.square_errors(theta)) / max(float(before.sum()) - noise, MIN_GAP * noise, 1e-12)
    energy = float(gain.sum())
    return GroupRefit(
        group.name,
        group.effects,
        subtract_control(asked, control),
        None if control is None else control.z,
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
