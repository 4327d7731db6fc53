"""A simulation with the correction and the effects that a diagnosis has found: again a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ces_gap.baseline.plant import Correction, DirectSimulator, Plant, TraceSimulator
from ces_gap.effects.effect import Composition
from ces_gap.errors import GapError
from ces_gap.trace import F, Trace, make_trace, smooth_recording
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation, find_predictions
from ces_observer.errors import CesError


@dataclass(frozen=True)
class AugmentedSimulation(Simulation):
    """A simulation with a correction and effects; `surrogate` replaces one that cannot be run again."""

    name: str
    simulation: Simulation
    composition: Composition
    correction: Correction | None = None
    surrogate: TraceSimulator | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def innermost(self) -> Simulation:
        """The simulation without any effects and corrections."""
        return self.simulation.innermost

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample (n,), NaN where the simulation has none.

        As in the diagnosis, the simulation runs on the smoothed position, if it can be run. The added force is computed
        on the grid of the trace and interpolated, so that the simulation's own force keeps its detail.
        """
        if not self.composition.settings and self.correction is None:
            return self.simulation.force(recording)
        if find_predictions(self.simulation) is None:
            recording = smooth_recording(recording, make_trace(recording, np.zeros(len(recording.channel("position")))))
        own = self.simulation.force(recording)
        trace = make_trace(recording, own)
        plant = Plant(self.surrogate or DirectSimulator(self.simulation), self.correction)
        added = self._apply_effects(plant, trace) - trace.simulated
        stamps = recording.channel("position").stamps_ns
        return np.asarray(own + np.interp((stamps - stamps[0]) * 1e-9, trace.time_s, added))

    def _apply_effects(self, plant: Plant, trace: Trace) -> F:
        try:
            force = plant.with_effects(self.composition, trace)
        except CesError:
            raise
        except Exception as error:  # inconsistent numbers in a file, or an effect of the user
            text = f"{type(error).__name__}: {' '.join(str(error).split())}"
            raise GapError(f"{self.name}: cannot be run: {text}; run `ces diagnose` again") from error
        if not np.isfinite(force).all():
            bad = float(trace.time_s[np.argmin(np.isfinite(force))])
            raise GapError(f"{self.name}: the force is not finite at {bad:.3f} s; run `ces diagnose` again")
        return force
