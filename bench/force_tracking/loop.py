"""The closed loop in lockstep: the live rig, the observer and the controller that the nodes run, tick by tick at 1 kHz.

The result of a run is a `TrackedRun`: desired force, true force, and where the desired force was reachable.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from math import nan

import numpy as np
from numpy.typing import NDArray

from ces_observer.control.control_loop import ControlLoop
from ces_observer.control.controller_tuning import Tuning
from ces_observer.control.force_controller import ForceController
from ces_observer.control.force_curve import ForceCurve
from ces_observer.control.steady_force import compute_inverse_map, current_lag_s
from ces_observer.current_hold import CurrentHold
from ces_observer.damper_observer import DamperObserver
from ces_observer.model import Model
from ces_observer.nodes.controller_table import CURVE
from ces_rig.dampers.hydraulic.stepper import Stepper, rest_force, spline_speed
from ces_rig.drive.vehicle_kernel import FORCE, STROKE
from ces_rig.live.rig import LiveRig, RigSample, RigSettings

F = NDArray[np.float64]

EPOCH_NS = 10**18
DELAY_TICKS = 2  # from a sample to the tick on which its command acts: three hops of a ROS graph at 1 kHz
SKIPPED_S = 2.0  # of a run, until controller and observer have warmed up
MIN_SPAN_N = 50.0  # between softest and firmest force; below, the valve has no influence
DESIRED = ForceCurve.from_points(*(spec.default for spec in CURVE))


@dataclass(frozen=True)
class Design:
    """The engineer's design: the model, and the controller that is derived from it."""

    model: Model
    controller: ForceController

    @classmethod
    def from_model(cls, model: Model) -> Design:
        tuning = Tuning(low_A=0.29, high_A=0.70, safe_A=0.40)
        tuning = replace(tuning, valve_lag_s=Tuning.lead_s(current_lag_s(model), tuning.preview_s))
        return cls(model, ForceController(DESIRED, compute_inverse_map(model), tuning))

    def fresh_loop(self, feedback: str) -> ControlLoop:
        """Return a loop in its initial state."""
        c = self.controller
        return ControlLoop(ForceController(c.curve, c.inverse, c.tuning), feedback, max_age_s=0.05)


@dataclass(frozen=True)
class TrackingResult:
    """The outcome of one run."""

    case: str
    stroke: str
    way: str
    seed: int
    J: float
    rms_N: float
    reachable: float


@dataclass(frozen=True)
class TrackedRun:
    """A run: true force, desired force at the true speed, commands, and where the desired force was reachable; (n,)."""

    time_s: F
    speed_m_s: F
    force_N: F
    desired_N: F
    estimate_N: F
    command_A: F
    reachable: NDArray[np.bool_]

    @property
    def rms_N(self) -> float:
        """RMS of the tracking error on reachable samples."""
        return float(np.sqrt(np.mean((self.force_N - self.desired_N)[self.reachable] ** 2)))

    @property
    def J(self) -> float:
        """The same in percent of the desired force's standard deviation, like the cost J."""
        return 100.0 * self.rms_N / float(np.std(self.desired_N[self.reachable]))


def track(settings: RigSettings, design: Design, feedback: str, seconds: float, driver: float = 1.0) -> TrackedRun:
    """Close the loop for `seconds`; the valve's driver gives `driver` times the command, within the working range."""
    rig, graph = LiveRig(settings), Graph(design, feedback)
    low, high = rig.damper.model.current_A
    commands = deque([graph.command_A] * (DELAY_TICKS - 1))
    signals = np.full((4, round(seconds * settings.rate_hz)), np.nan)
    for k in range(signals.shape[1]):
        sample = rig.tick()
        commands.append(graph.answer(sample, rig.time_s))
        rig.command.set_current(min(max(driver * commands.popleft(), low), high), rig.time_s)
        signals[:, k] = rig.motion[STROKE], rig.motion[FORCE], graph.estimate_N, graph.command_A
    return evaluate_run(rig, *signals)


class Graph:
    """Observer and controller, as run by two nodes."""

    def __init__(self, design: Design, feedback: str) -> None:
        self._loop = design.fresh_loop(feedback)
        self._observer = DamperObserver(design.model, CurrentHold(design.model.sampling.max_current_age_s), 0.0)
        self.estimate_N = nan

    @property
    def command_A(self) -> float:
        """The last command."""
        return self._loop.controller.command_A

    def answer(self, sample: RigSample, time_s: float) -> float:
        """Return the command [A] that follows a sample of the rig."""
        stamp_ns = EPOCH_NS + round(time_s * 1e9)
        if sample.current_A is not None:
            self._observer.take_current(stamp_ns, sample.current_A)
        if sample.force_N is not None:
            self._loop.take_measured_force(sample.force_N, time_s)
        force = None if sample.position_m is None else self._observer.step(stamp_ns, sample.position_m, stamp_ns)
        self.estimate_N = nan if force is None else force
        if force is None:
            self._loop.watch(time_s)
        else:
            self._loop.take_estimate(stamp_ns, self._observer.speed, force, stamp_ns, time_s)
        return self.command_A


def evaluate_run(rig: LiveRig, stroke_m: F, force_N: F, estimate_N: F, command_A: F) -> TrackedRun:
    """Return the run with the desired force, and where the same damper could reach it on the same stroke."""
    interval = rig.period_s
    time = np.arange(1, len(stroke_m) + 1) * interval
    speed = spline_speed(time, stroke_m)
    desired = np.array([DESIRED.at(v) for v in speed])
    soft, firm = (force_at_current(rig, stroke_m, speed, current) for current in rig.damper.model.current_A)
    low, high = np.minimum(soft, firm), np.maximum(soft, firm)
    reachable = (high - low > MIN_SPAN_N) & (desired >= low) & (desired <= high) & (time > SKIPPED_S)
    return TrackedRun(time, speed, force_N, desired, estimate_N, command_A, reachable)


def force_at_current(rig: LiveRig, stroke_m: F, speed_m_s: F, current_A: float) -> F:
    """Return the force [N] of the rig's damper on this stroke at constant current."""
    hydraulic = rig.damper.model
    stepper = Stepper(hydraulic.damper, rig.period_s, extras=hydraulic.extras)
    stepper.reset(stroke_m[0], speed_m_s[0], current_A)
    return stepper.advance(stroke_m, speed_m_s, np.full_like(stroke_m, current_A)) - rest_force(hydraulic.damper)
