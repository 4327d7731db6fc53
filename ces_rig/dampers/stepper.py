"""The kinds of damper, and how one is stepped: along a stroke, by a servo actuator or in a vehicle, also in chunks.

Recorded runs, the actuated damper and the live rig all use `DamperStepper`, so that their forces are the same. A given
stroke comes with its speed, because between samples it is the cubic through both.

Each kind is a package beside this file and an entry in `KINDS`. A new one needs parameters (a `LumpedDamper` if its
description is flat), a kernel, its `KIND` and an entry; simulations, blind cases and the live rig then support it.
`ces_cli.blind.DEFAULT_PLANTS` names those that blind cases use without `--plants`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from ces_data.arrays import F
from ces_observer.fields import Field
from ces_observer.records import OneOf, Record
from ces_rig.dampers import bouc_wen, hydraulic, lookup
from ces_rig.dampers.hydraulic.parameters import Damper, HydraulicDamper
from ces_rig.dampers.model import DamperKind, LumpedDamper, RigDamper
from ces_rig.drive import CURRENT, GIVEN, MOTION_SIZE, ROWS, STROKE, STROKE_SPEED
from ces_rig.errors import RigError

HYDRAULIC = HydraulicDamper.kind
KINDS: Mapping[str, DamperKind] = {m.KIND.design.kind: m.KIND for m in (hydraulic, bouc_wen, lookup)}
LUMPED: Mapping[str, type[LumpedDamper]] = {
    name: type(kind.design) for name, kind in KINDS.items() if isinstance(kind.design, LumpedDamper)
}
DAMPER = Field(kind=OneOf({HYDRAULIC: Record(Damper, partial=True), **LUMPED}))


def parse_model(description: Mapping[str, Any], where: str) -> RigDamper:
    """Return the damper of a description of any kind; raises RigError for an unknown kind or a number out of range."""
    damper: Damper | LumpedDamper = DAMPER.check({"kind": HYDRAULIC, **description}, where, RigError)
    return HydraulicDamper(damper) if isinstance(damper, Damper) else damper


class Mover(NamedTuple):
    """What moves a damper: its kind in `ces_rig.drive` and the numbers of its kernel."""

    kind: int
    numbers: F


GIVEN_STROKE = Mover(GIVEN, np.empty(0))


class DamperStepper:
    """A damper with a state that persists between chunks; chunks give exactly the forces of one batch.

    Forces include the gas force; `rest_N` is that at mid-stroke, which a tare subtracts. `motion` is that of the mover.
    """

    def __init__(
        self, model: RigDamper, interval_s: float, step_s: float | None = None, mover: Mover = GIVEN_STROKE
    ) -> None:
        self.kind = KINDS[model.kind]
        step_s = self.kind.kernel.STEP_S if step_s is None else step_s
        if not interval_s > 0.0 or not step_s > 0.0:
            raise RigError(f"interval {interval_s!r} s and step {step_s!r} s; expected numbers above 0")
        self.model, self.mover = model, mover
        self.interval_s, self.substeps = interval_s, max(1, round(interval_s / step_s))
        self._coefficients = self.kind.kernel.Numbers(*model.coefficients())
        self.numbers = np.array(self._coefficients)
        self.rest_N = float(self.kind.kernel.rest_force(self._coefficients))
        self.state, self.motion = np.zeros(self.kind.kernel.STATE_SIZE), np.zeros(MOTION_SIZE)
        self._unrecorded = np.empty((0, len(self.state)))
        self.settle()

    def settle(self, stroke_m: float = 0.0, speed_m_s: float = 0.0, current_A: float = 0.0) -> float:
        """Bring the damper to rest at this input and return its force [N]."""
        self._last = np.array([stroke_m, speed_m_s, current_A])
        return float(self.kind.kernel.settle(self._coefficients, self.state, stroke_m, speed_m_s, current_A))

    def advance(self, stroke_m: F, speed_m_s: F | float, current_A: F | float, states: F | None = None) -> F:
        """Return the force [N] (n,) at the next n inputs, one every `interval_s`; fills `states` (n, STATE_SIZE).

        `stroke_m` (n,) is the road's height or the servo's input if these move the damper; the speed then does not
        matter.
        """
        moves = np.empty((ROWS, len(stroke_m) + 1))
        moves[:, 0] = self._last
        moves[STROKE, 1:], moves[STROKE_SPEED, 1:] = stroke_m, speed_m_s
        moves[CURRENT, 1:] = current_A
        force = np.empty(len(stroke_m))
        self.kind.kernel.run(
            self.numbers, self.state, self.mover.kind, self.mover.numbers, self.motion, moves, self.interval_s,
            self.substeps, force, self._unrecorded if states is None else states,
        )  # fmt: skip
        self._last = moves[:, -1]
        return force

    @property
    def coil_A(self) -> float:
        """The current in the coil [A]."""
        return float(self.state[self.kind.kernel.COIL])


@dataclass(frozen=True)
class SimulatedRun:
    """A run: times, forces (n,), states (n, STATE_SIZE); `tared_N` is without the gas force at mid-stroke `rest_N`."""

    time_s: F
    force_N: F
    states: F
    kind: DamperKind
    rest_N: float

    @property
    def tared_N(self) -> F:
        """Force [N] without the gas force at mid-stroke, (n,)."""
        return self.force_N - self.rest_N

    @property
    def coil_A(self) -> F:
        """Current in the coil [A], (n,)."""
        return np.asarray(self.states[:, self.kind.kernel.COIL])

    @property
    def temperature_degC(self) -> F:
        """Temperature of oil or fluid [°C], (n,)."""
        return np.asarray(self.states[:, self.kind.kernel.TEMPERATURE])

    def state(self, name: str) -> F:
        """Return one state over time, by its name in the kernel's STATE_NAMES, for kinds that have names."""
        return np.asarray(self.states[:, self.kind.kernel.STATE_NAMES.index(name)])


def simulate(
    model: RigDamper, interval_s: float, stroke_m: F, current_A: F, speed_m_s: F | None = None,
    step_s: float | None = None,
) -> SimulatedRun:  # fmt: skip
    """Drive a damper from rest with samples every `interval_s` seconds; all arrays of shape (n,), n at least 2.

    Without `speed_m_s` the speed is that of the cubic spline through the stroke. Raises RigError for what the damper
    cannot be driven with.
    """
    stroke, current = np.asarray(stroke_m, dtype=np.float64), np.asarray(current_A, dtype=np.float64)
    model.check_input(stroke, current)
    time = np.arange(len(stroke), dtype=np.float64) * interval_s
    speed = spline_speed(time, stroke) if speed_m_s is None else np.asarray(speed_m_s, dtype=np.float64)
    stepper = DamperStepper(model, interval_s, step_s)
    force, states = np.empty(len(stroke)), np.empty((len(stroke), len(stepper.state)))
    force[0], states[0] = stepper.settle(stroke[0], speed[0], current[0]), stepper.state
    start, absorbed_J = 1, 0.0
    while start < len(stroke):
        length = min(model.refresh(stepper.numbers, absorbed_J) / interval_s, len(stroke))
        part = slice(start, start + max(1, round(length)))
        force[part] = stepper.advance(stroke[part], speed[part], current[part], states[part])
        absorbed_J += abs(float(np.dot(force[part], speed[part]))) * interval_s
        start = part.stop
    return SimulatedRun(time, force, states, stepper.kind, stepper.rest_N)


def spline_speed(time_s: F, stroke_m: F) -> F:
    """Return the derivative [m/s] of the cubic spline through `stroke_m`."""
    return np.asarray(CubicSpline(time_s, stroke_m)(time_s, 1), dtype=np.float64)
