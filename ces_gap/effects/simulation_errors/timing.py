"""Simulation timing: the simulated force comes up to a sample early or late, or is smoothed over a few samples.

Whoever logs or resamples a simulation skews and smooths it a little. That is neither a delay nor a mass of the damper,
so it is fitted within the bounds of sampling and never named as a cause (`nuisance`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ces_gap.effects.effect import SIMULATION, Effect, EffectParameter
from ces_gap.trace import F, Trace, TraceInputs

MAX_GAIN = 3.0  # of the sharpening of a force that was smoothed: it also amplifies noise
RUN_OUT_S = 0.25  # [s] of padding, because the Fourier transform is periodic


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
        count = len(force)
        padded = next_fast_len(count + round(RUN_OUT_S * trace.rate_Hz), real=True)
        bridge = np.linspace(force[-1], force[0], padded - count + 2)[1:-1]
        w = 2.0 * np.pi * trace.rate_Hz * np.arange(padded // 2 + 1) / padded
        gain = np.minimum(np.exp(-0.5 * spread_s2 * w * w), MAX_GAIN)
        spectrum = rfft(np.concatenate([force, bridge])) * gain * np.exp(-1j * w * skew_s)
        return np.asarray(irfft(spectrum, padded)[:count])


FORMS = (SampleTiming(),)
