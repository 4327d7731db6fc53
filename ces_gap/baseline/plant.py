"""The plant of a diagnosis: changed inputs on the grid of a trace in, the force on that grid out.

It runs the simulation, or its twin if only its predictions were recorded, and adds the correction of the baseline
error and what effects change inside the twin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ces_data.arrays import F
from ces_data.recording import Channel, Recording
from ces_gap.baseline.learner import LearnedCorrection
from ces_gap.effects.effect import Composition
from ces_gap.errors import GapError
from ces_gap.trace import Trace, TraceInputs, resample_to_grid
from ces_identify.simulations.simulation import Simulation


class TraceSimulator(Protocol):
    """Simulates a trace again with other inputs."""

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the force [N] on the grid (n,) for `inputs`."""
        ...

    def error_of_change(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the standard error [N] (n,) of the change of force from the recorded inputs to `inputs`: none here."""
        return np.zeros(len(trace))

    def change(self, trace: Trace, inputs: TraceInputs, composition: Composition) -> F:
        """Return the change of force [N] (n,) by the effects of a composition that lie inside: none here."""
        return np.zeros(len(trace))

    def prepare_for(self, trace: Trace) -> TraceSimulator:
        """Return a simulator for this trace only, its results for the recorded inputs computed once."""
        return self


@dataclass(frozen=True)
class DirectSimulator(TraceSimulator):
    """A simulation that can be called with any inputs."""

    simulation: Simulation

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the simulated force [N] on the grid (n,); the position keeps its logged noise and jitter."""
        return resample_to_grid(trace, self.simulation.force(change_recording(trace, inputs)))


@dataclass(frozen=True)
class Plant:
    """A simulation with its correction, and its twin for effects that lie inside."""

    simulation: TraceSimulator
    correction: LearnedCorrection | None = None
    twin: TraceSimulator | None = None

    def prepare_for(self, trace: Trace) -> Plant:
        """Return the plant for this trace only, with its simulator and its twin prepared."""
        twin = None if self.twin is None else self.twin.prepare_for(trace)
        return replace(self, simulation=self.simulation.prepare_for(trace), twin=twin)

    def alone(self, trace: Trace) -> F:
        """Return the corrected force [N] (n,) for the recorded inputs, without running the simulation again."""
        return self._correct(trace, trace.inputs, trace.simulated)

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the corrected force [N] (n,) for `inputs`."""
        return self._correct(trace, inputs, self.simulation.force(trace, inputs))

    def with_effects(self, composition: Composition, trace: Trace, alone: F | None = None) -> F:
        """Return the force [N] (n,) of the plant with effects; `alone` is its force without them, if already computed.

        Effects on the inputs that depend on the damper's force get the force without effects and solve for the rest.
        """
        force, inputs = self.alone(trace) if alone is None else alone, trace.inputs
        if composition.reruns:
            inputs = composition.drive(trace, force)
            force = self.force(trace, inputs)
        if composition.edits:
            if self.twin is None:
                raise GapError(f"{trace.name}: no twin of the simulation, into which effects could be put")
            force = force + self.twin.change(trace, inputs, composition)
        return composition.respond(trace, inputs, force)

    def error_with_effects(self, composition: Composition, trace: Trace, alone: F | None = None) -> F:
        """Return the standard error [N] (n,) of `with_effects` that a twin in place of the simulation causes.

        It is zero for effects that do not run the simulation again, and where the simulation itself runs.
        """
        if not composition.reruns:
            return np.zeros(len(trace))
        force = self.alone(trace) if alone is None else alone
        return self.simulation.error_of_change(trace, composition.drive(trace, force))

    def _correct(self, trace: Trace, inputs: TraceInputs, simulated: F) -> F:
        if self.correction is None:
            return simulated
        return simulated + self.correction.force(trace, inputs, simulated)


def change_recording(trace: Trace, inputs: TraceInputs) -> Recording:
    """Return the recording with position and current changed by the difference of `inputs` from the recorded ones."""
    recording, start = trace.recording, trace.recording.channel("position").stamps_ns[0]
    channels = {n: c for n, c in recording.channels.items() if n != "sim_force"}
    constants = dict(recording.constants)

    def move(logged: Channel, change: F) -> Channel:
        added = np.interp((logged.stamps_ns - start) * 1e-9, trace.time_s, change)
        return replace(logged, values=logged.values + added)

    channels["position"] = move(channels["position"], inputs.position - trace.inputs.position)
    if not inputs.current_as_logged:
        if constants.pop("current", None) is not None or len(channels["current"]) < len(trace):
            channels["current"] = Channel("current", "A", trace.grid_ns(), inputs.current)
        else:
            channels["current"] = move(channels["current"], inputs.current - trace.inputs.current)
    return replace(recording, channels=channels, constants=constants)
