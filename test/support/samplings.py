"""Sampling rules of a usual position sensor at any rate, for tests."""

from __future__ import annotations

from typing import Any

from ces_observer.model import FREQUENCIES_HZ, Sampling


def make_sampling(rate_Hz: float = 1000.0, outlier_m: float = 0.005, **changes: Any) -> Sampling:
    """Return rules for 10 um of noise and an RMS speed of 0.2 m/s, with modes that suit the rate."""
    frequencies = tuple(f for f in FREQUENCIES_HZ if f <= 0.125 * rate_Hz) or (0.125 * rate_Hz,)
    usual = {"noise_m": 1e-5, "speed_m_s": 0.2, "stroke_m": (-1.0, 1.0), "frequencies_Hz": frequencies}
    return Sampling(**{"rate_Hz": rate_Hz, "outlier_m": outlier_m, **usual, **changes})
