"""Simulation timing: the simulated force comes up to a sample early or late, or is smoothed over a few samples.

Whoever logs or resamples a simulation skews and smooths it a little. That is neither a delay nor a mass of the damper,
so it is fitted within the bounds of sampling and never named as a cause (`nuisance`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ces_gap.effects.effect import SIMULATION, Effect, EffectParameter
from ces_gap.effects.frequency_response import apply_response
from ces_gap.trace import F, Trace, TraceInputs

MAX_GAIN = 3.0  # of the sharpening of a force that was smoothed: it also amplifies noise


class SampleTiming(Effect):
    """The simulated force behind exp(-i w skew - w² spread / 2): a shift and a smoothing that are counted in samples.

    A moving average over m samples has a spread of (m² - 1)/12 samples²; linear interpolation and a hold are alike. A
    negative spread sharpens a simulated force that had been smoothed.
    """

    name, form, stage, nuisance = "simulation_timing", "samples", SIMULATION, True
    needs = "motion"
    parameters = (
        EffectParameter("skew_samples", -1.0, 1.0, (0.0,), "delay to be added to the simulated force", magnitude=True),
        EffectParameter("spread_samples2", -2.0, 2.0, (0.0,), "smoothing to be added to it", magnitude=True),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return the force [N] (n,) with the timing corrected."""
        skew_s, spread_s2 = values[0] * trace.sample_s, values[1] * trace.sample_s**2

        def response(w: F) -> NDArray[np.complex128]:
            return np.asarray(np.minimum(np.exp(-0.5 * spread_s2 * w * w), MAX_GAIN) * np.exp(-1j * w * skew_s))

        return apply_response(force, trace.rate_Hz, response)


FORMS = (SampleTiming(),)
