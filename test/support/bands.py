"""A band with round numbers, for tests."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ces_observer.model import Band

if TYPE_CHECKING:
    from ces_data.arrays import F
    from ces_identify.simulations.simulate import SampleRun

BAND = Band(
    level=0.9,
    change_s=0.01,
    reversal_s=0.02,
    speed_m_s=0.5,
    current_A=(0.2, 0.7),
    parts=(10.0, 30.0, 20.0, 5.0, 0.02, 0.05, 40.0),
    mean=(0.001, 0.02, 0.45, 0.0, 0.0),
    whitening=((100.0, 3.0, -2.0, 1.0, 0.5), (2.0, 0.3, -0.2, 0.1), (8.0, 1.0, -1.0), (4.0, 0.7), (6.0,)),
    max_distance=4.0,
    constant_share=0.2,
)


def make_band(**changes: Any) -> Band:
    """Return the band with some numbers changed."""
    return replace(BAND, **changes)


def lower_bounds(at: SampleRun) -> F:
    """Return the lower bound [N] at the position samples (n,), NaN without a force."""
    import numpy as np  # here, as many tests need the band alone

    from ces_identify.validation.band import band_half_width

    assert at.model.band is not None
    return np.asarray(at.force - np.append(band_half_width(at.model.band, at.series, at.run.force), np.nan)[at.newest])
