"""Checks constructed inputs against the estimation data: refuses those outside it and narrows ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.polynomial.constructed_series import constructed_values
from ces_identify.polynomial.regressors import CandidateRules
from ces_identify.preparation.series import Series
from ces_observer.errors import CesError
from ces_observer.model import Envelope
from ces_observer.structures.constructed_inputs import (
    ConstructedInput,
    Frequency,
    Hysteresis,
    Lag,
    TriangularMembership,
)

ANYTHING = Envelope((-inf, inf), (-inf, inf), (-inf, inf))
MARGIN = 0.1  # of the data's range, added at both ends of a frequency's range


def restrict_to_data(rules: CandidateRules, series: Sequence[Series]) -> CandidateRules:
    """Return `rules` with the range of each frequency narrowed to that of `series`.

    Raises CesError for a membership that peaks outside the data, or a hysteresis wider than the data. A lag with an
    open time constant is assumed to have the range of its signal.
    """
    constructed = {
        name: tuple(_fit_to_data(one, series, rules.open_lags) for one in group)
        for name, group in rules.constructed.items()
    }
    return replace(rules, constructed=constructed)


def _fit_to_data(one: ConstructedInput, series: Sequence[Series], open_lags: Sequence[str]) -> ConstructedInput:
    if isinstance(one, TriangularMembership):
        base = None if one.base is None else _fit_to_data(one.base, series, open_lags)
        if isinstance(base, Lag) and base.name in open_lags:
            _require_inside(one, _scored_values(base.of, None, series))
        else:
            _require_inside(one, _scored_values(one.of, base, series))
        return replace(one, base=base)
    if isinstance(one, Frequency):
        return _narrow_range(one, _scored_values(one.name, one, series))
    if not isinstance(one, Lag):
        _require_narrow(one, _scored_values(one.of, None, series))
    return one


def _scored_values(signal: str, definition: ConstructedInput | None, series: Sequence[Series]) -> F:
    """Return the values (n,) of a signal on all scored ticks."""
    values = []
    for s in series:
        inputs = {"position": s.position, "speed": s.speed, "current": s.current}
        if definition is not None:
            inputs |= constructed_values([definition], ANYTHING, tuple(inputs.values()), s.segments, s.rate_Hz)
        values.append(inputs[signal][s.scored])
    return np.concatenate(values)


def _narrow_range(one: Frequency, data: F) -> Frequency:
    low, high = one.range_Hz
    margin = MARGIN * float(np.ptp(data))
    narrow = max(low, float(data.min()) - margin), min(high, float(data.max()) + margin)
    if not narrow[0] < narrow[1]:
        raise CesError(f"{one.name}: the data stay at {data.min():g} Hz; expected motion within {low:g}-{high:g} Hz")
    return replace(one, range_Hz=narrow)


def _require_inside(hat: TriangularMembership, data: F) -> None:
    if not data.min() <= hat.peak <= data.max():
        raise CesError(
            f"{hat.name}: peaks at {hat.of} {hat.peak:g}, outside the data's {data.min():g} to {data.max():g}; "
            "expected peaks between"
        )


def _require_narrow(one: Hysteresis, data: F) -> None:
    if 2.0 * one.half_width >= np.ptp(data):
        raise CesError(
            f"{one.name}: half width {one.half_width:g} spans all of the data's {one.of}, "
            f"{data.min():g} to {data.max():g}; expected a narrower hysteresis"
        )
