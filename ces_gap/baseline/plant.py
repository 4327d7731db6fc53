"""The simulation as the diagnosis asks it: changed inputs on a trace's grid go in, a force on that grid comes out.

A simulation that can be called is called; one whose predictions were only recorded is stood in for by a surrogate. The
baseline's own error, learnt from reference recordings, is added as a `Correction`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ces_gap.effects.effect import Composition
from ces_gap.trace import F, Trace, TraceInputs, resample_to_grid
from ces_identify.recordings.recording import Channel, Recording
from ces_identify.simulations.simulation import Simulation


class TraceSimulator(Protocol):
    """What can simulate a trace again with other inputs; every kind is a subclass."""

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the force [N] on the grid (n,) that is simulated for `inputs`."""
        ...

    def prepare_for(self, trace: Trace) -> TraceSimulator:
        """Return the same for this trace alone, with what it needs of the recorded inputs computed once."""
        return self


class Correction(Protocol):
    """The baseline's own error as a function of its inputs and its force."""

    def force(self, trace: Trace, inputs: TraceInputs, simulated: F) -> F:
        """Return what to add [N] (n,)."""


@dataclass(frozen=True)
class DirectSimulator(TraceSimulator):
    """A simulation that can be called with any inputs."""

    simulation: Simulation

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the simulated force [N] on the grid (n,); the position keeps its logged noise and jitter."""
        return resample_to_grid(trace, self.simulation.force(change_recording(trace, inputs)))


@dataclass(frozen=True)
class Plant:
    """A simulation with the correction that references taught."""

    simulation: TraceSimulator
    correction: Correction | None = None

    def prepare_for(self, trace: Trace) -> Plant:
        """Return the plant for this trace alone, what its simulation needs of the recorded inputs computed once."""
        return replace(self, simulation=self.simulation.prepare_for(trace))

    def alone(self, trace: Trace) -> F:
        """Return the corrected force [N] (n,) under the recorded inputs; nothing is simulated again."""
        return self._correct(trace, trace.inputs, trace.simulated)

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the corrected force [N] (n,) that is simulated for `inputs`."""
        return self._correct(trace, inputs, self.simulation.force(trace, inputs))

    def with_effects(self, composition: Composition, trace: Trace, alone: F | None = None) -> F:
        """Return the force [N] (n,) with the effects around the plant; `alone` is the plant's own, if at hand.

        Effects on the input that depend on the damper's force are told its force without them, and solve for the rest.
        """
        force = self.alone(trace) if alone is None else alone
        if not any(s.effect.reruns for s in composition.settings):
            return composition.respond(trace, trace.inputs, force)
        inputs = composition.drive(trace, force)
        return composition.respond(trace, inputs, self.force(trace, inputs))

    def _correct(self, trace: Trace, inputs: TraceInputs, simulated: F) -> F:
        if self.correction is None:
            return simulated
        return simulated + self.correction.force(trace, inputs, simulated)


def _change_current_channel(trace: Trace, inputs: TraceInputs, constant: float | None) -> Channel:
    """Return the current channel with what `inputs` differ added to what was logged."""
    if constant is not None or len(trace.recording.channel("current")) < len(trace):
        return Channel("current", "A", trace.grid_ns(), inputs.current)
    logged = trace.recording.channel("current")
    seconds = (logged.stamps_ns - trace.recording.channel("position").stamps_ns[0]) * 1e-9
    added = np.interp(seconds, trace.time_s, inputs.current - trace.inputs.current)
    return replace(logged, values=logged.values + added)


def change_recording(trace: Trace, inputs: TraceInputs) -> Recording:
    """Return the trace's recording with its position moved, and its current replaced, by what `inputs` differ."""
    recording = trace.recording
    channels = {n: c for n, c in recording.channels.items() if n not in ("sim_force",)}
    constants = dict(recording.constants)
    position = recording.channel("position")
    seconds = (position.stamps_ns - position.stamps_ns[0]) * 1e-9
    moved = np.interp(seconds, trace.time_s, inputs.position - trace.inputs.position)
    channels["position"] = replace(position, values=position.values + moved)
    if not inputs.current_as_logged:
        channels["current"] = _change_current_channel(trace, inputs, constants.pop("current", None))
    return replace(recording, channels=channels, constants=constants)
