"""The twin of a simulation: a hydraulic network fitted to its force, into which effects can be put.

Only differences are used. The force with an effect inside is that of the simulation, plus the twin's with the effect,
minus the twin's without; that of a simulation which cannot be run again, under other inputs, is the recorded one plus
the difference of the twin's. So the force at the recorded inputs is exact. A simulation does not know what time it is:
if an effect moves the motion in time, the twin's error there is moved with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from ces_data.arrays import F
from ces_gap.baseline.plant import TraceSimulator
from ces_gap.effects.effect import Composition, TwinRun
from ces_gap.grid import thin_out
from ces_gap.limits import TwinLimits
from ces_gap.trace import Trace, TraceInputs, bridge_current
from ces_observer.errors import ModelError
from ces_observer.fields import Field
from ces_observer.records import Record, bounded, part, read_document, write_record
from ces_observer.structures.hydraulic import Hydraulic

SCHEMA = "ces-twin/1"
STEP_S = 1e-3  # [s] longest step of a twin: half of it gains next to nothing
MAX_TICKS = 400_000  # of all steps of one run: longer recordings get longer steps, down to the position's rate


@dataclass(frozen=True)
class Twin(TraceSimulator):
    """A network `body`, whose dead time is counted in ticks of `tick_s`, and a column of oil that rings.

    `column_s2` is the column's mass over its stiffness [s²], 0 without one. `cost_J` is the cost J [%] (thesis eq. 3.5)
    on blocks of the simulated force left out of the fit.
    """

    body: Hydraulic = part(inline=True)
    tick_s: float = bounded(1e-6, 1.0)
    cost_J: float = bounded(0.0, inf)
    column_s2: float = bounded(0.0, 1.0, default=0.0, optional=True)  # older files have none

    def change_error(self, inputs: TraceInputs) -> float:
        """Return the error of a change of force by other `inputs`, relative to the change."""
        return min(
            (TwinLimits.CHANGE_ERROR if inputs.current_as_logged else TwinLimits.CURRENT_ERROR) * 0.01 * self.cost_J,
            1.0,
        )

    def prepare_for(self, trace: Trace) -> TraceTwin:
        """Return the twin for this trace only, its force for the recorded inputs computed once."""
        return TraceTwin(self, trace)

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the simulated force [N] (n,) for the inputs."""
        return self.prepare_for(trace).force(trace, inputs)

    def error_of_change(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the standard error [N] (n,) of the change of force from the recorded inputs to `inputs`."""
        return self.prepare_for(trace).error_of_change(trace, inputs)

    def change(self, trace: Trace, inputs: TraceInputs, composition: Composition) -> F:
        """Return the change of force [N] (n,) by the effects of a composition that lie inside."""
        return self.prepare_for(trace).change(trace, inputs, composition)

    def as_json(self) -> dict[str, Any]:
        """Return the twin as plain values."""
        return {"schema": SCHEMA, **write_record(self), "column_s2": self.column_s2}

    @classmethod
    def from_json(cls, document: Mapping[str, Any], where: str = "twin") -> Twin:
        """Return the twin from `as_json`; raises ModelError if the document is not one."""
        again = "run `ces diagnose` again"
        twin: Twin = read_document(Field(kind=Record(cls)), document, where, SCHEMA, again, ModelError)
        return twin


@dataclass(frozen=True)
class TraceTwin(TraceSimulator):
    """A twin on one trace."""

    twin: Twin
    trace: Trace

    @cached_property
    def run(self) -> TwinRun:
        """The run with the recorded inputs: the smoothed motion, and the current as it was held."""
        return make_run(self.twin, self.trace)

    @cached_property
    def recorded_force(self) -> F:
        """The twin's force [N] (n,) for the recorded inputs."""
        return self._on_grid(self.run)

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the simulated force [N] (n,) for the inputs."""
        if inputs is self.trace.inputs:
            return self.trace.simulated
        error = self.trace.simulated - self.recorded_force
        return self._on_grid(self._with(inputs)) + carry_error(error, self.trace, inputs)

    def error_of_change(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the standard error [N] (n,) of the change of force from the recorded inputs to `inputs`."""
        return np.asarray(self.twin.change_error(inputs) * np.abs(self.force(trace, inputs) - self.trace.simulated))

    def change(self, trace: Trace, inputs: TraceInputs, composition: Composition) -> F:
        """Return the change of force [N] (n,) by the effects of a composition that lie inside."""
        plain = self._with(inputs)
        after, share = self._on_grid(composition.edit(plain)), composition.network_share
        if share:
            return np.asarray(share * (after - self.force(trace, inputs)))
        before = self.recorded_force if inputs is self.trace.inputs else self._on_grid(plain)
        return np.asarray(after - before)

    def _with(self, inputs: TraceInputs) -> TwinRun:
        """Return the run with changed inputs."""
        if inputs is self.trace.inputs:
            return self.run
        time_s = self.run.step_s * np.arange(len(self.run.position))
        moved = CubicSpline(self.trace.time_s, inputs.position - self.trace.inputs.position)
        position, speed = self.run.position + moved(time_s), self.run.speed + moved(time_s, 1)
        current = self.run.current
        if not inputs.current_as_logged:
            current = current + np.interp(time_s, self.trace.time_s, inputs.current - self.trace.inputs.current)
        return replace(self.run, position=position, speed=speed, current=current)

    def _on_grid(self, run: TwinRun) -> F:
        _, base, factor = self.trace.base_grid
        return thin_out(run.force()[:: count_steps(self.trace)][: len(base)], factor)


def count_steps(trace: Trace) -> int:
    """Return how many steps a twin takes from one tick of the trace's base grid to the next."""
    _, base, _ = trace.base_grid
    wanted = max(1, round(float(base[1] - base[0]) / STEP_S))
    return max(1, min(wanted, MAX_TICKS // len(base)))


def make_run(twin: Twin, trace: Trace) -> TwinRun:
    """Return the run of a twin over the recorded inputs of a trace."""
    position, speed, current, step_s = sample_inputs(trace, count_steps(trace))
    valve = twin.body.valve
    body = replace(twin.body, valve=replace(valve, delay_ticks=valve.delay_ticks * twin.tick_s / step_s))
    return TwinRun(body, position, speed, current, step_s, twin.column_s2)


def sample_inputs(trace: Trace, steps: int) -> tuple[F, F, F, float]:
    """Return position [m], speed [m/s] and current [A] (m,) at `steps` to a tick of the base grid, and the step [s].

    A simulation gets a current with each position sample, and holds it.
    """
    _, base, _ = trace.base_grid
    step_s = float(base[1] - base[0]) / steps
    time_s = np.arange((len(base) - 1) * steps + 1) * step_s
    motion, inside = CubicSpline(trace.time_s, trace.inputs.position), np.minimum(time_s, trace.time_s[-1])
    current = np.repeat(bridge_current(trace.recording, base)[0], steps)[: len(time_s)]
    return motion(inside), motion(inside, 1), current, step_s


def carry_error(error: F, trace: Trace, inputs: TraceInputs) -> F:
    """Return the error [N] (n,) at the recorded inputs moved in time as the changed motion is.

    The delay is that of the position that fits the change best, in least squares: x - x' = delay v.
    """
    speed = trace.inputs.speed
    moved = trace.inputs.position - inputs.position
    size = float(speed @ speed)
    delay_s = float(speed @ moved) / size if size > 0.0 else 0.0
    return error if delay_s == 0.0 else np.interp(trace.time_s - delay_s, trace.time_s, error)
