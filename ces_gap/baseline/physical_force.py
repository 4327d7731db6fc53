"""A structure with the physics inside as a function of changed inputs: inputs on a grid in, force on that grid out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ces_gap.trace import F, Trace, TraceInputs
from ces_identify.physical.chambers_kernels import run_chambers
from ces_identify.physical.chambers_models import chamber_arrays
from ces_identify.physical.models import NO_FIT, Body, Kernel
from ces_identify.physical.relaxation_kernels import run_relaxation
from ces_identify.physical.relaxation_models import relaxation_arrays
from ces_identify.physical.valve_kernels import RunData, Score
from ces_observer.json_checks import JsonObject
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.relaxation import Relaxation

BODIES: dict[str, type[Relaxation] | type[Chambers]] = {body.name: body for body in (Relaxation, Chambers)}
KERNELS: dict[str, tuple[Kernel, Callable[[Any, float], Any]]] = {
    Relaxation.name: (run_relaxation, relaxation_arrays),
    Chambers.name: (run_chambers, chamber_arrays),
}
MAX_RATE_HZ = 1e5
FAR = 0.25  # of the range of recorded currents: a current this far from the nearest is far
MIN_CHANGE = 1e-3  # of that distance: a smaller change of the current is none


@dataclass(frozen=True)
class PhysicalForce:
    """A relaxation model or chambers; the dead time of `body` is counted in ticks at `rate_Hz`."""

    body: Body
    rate_Hz: float

    def predict(self, inputs: TraceInputs, rate_Hz: float) -> F:
        """Return the force [N] (n,) of a free run over inputs at `rate_Hz`."""
        valve = self.body.valve
        delay = valve.delay_ticks * rate_Hz / self.rate_Hz
        kernel, as_arrays = KERNELS[self.body.name]
        arrays = as_arrays(replace(self.body, valve=replace(valve, delay_ticks=delay)), 1.0 / rate_Hz)
        position, speed, current = map(np.ascontiguousarray, (inputs.position, inputs.speed, inputs.current))
        ticks = len(position)
        nothing, force = np.zeros(ticks), np.empty(ticks)
        score = Score(nothing, nothing, np.zeros(ticks, np.int64), 1)
        kernel(arrays, RunData(position, speed, current, np.array([[0, ticks]])), score, force, NO_FIT, NO_FIT)
        return force

    def distance_from_currents(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return how far changed currents (n,) are from those that were often recorded: 0 at them, at most 1.

        The nodes of the valve's characteristic are those currents, but for its ends.
        """
        at = np.array(self.body.valve.characteristic.at)
        known = at[1:-1]
        scale = FAR * (float(np.ptp(known)) if len(known) > 1 else float(at[-1] - at[-2]))
        distance = np.abs(inputs.current[:, None] - known).min(axis=1) / scale
        changed = np.abs(inputs.current - trace.inputs.current) > MIN_CHANGE * scale
        return np.where(changed, np.minimum(distance, 1.0), 0.0)

    def as_json(self) -> dict[str, Any]:
        """Return the model as plain values."""
        return {"structure": self.body.name, "rate_Hz": self.rate_Hz, **self.body.to_json()}

    @classmethod
    def from_json(cls, document: JsonObject) -> PhysicalForce:
        """Return the model from `as_json`; raises ModelError if the document is not one."""
        body = BODIES[document.choice("structure", tuple(BODIES))]
        return cls(body.from_json(document, {}), document.number("rate_Hz", 1.0, MAX_RATE_HZ))
