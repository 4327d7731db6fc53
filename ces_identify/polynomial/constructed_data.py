"""Constructed inputs against the data they are to be fitted on: what lies outside is refused, ranges are narrowed."""

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
MARGIN = 0.1  # of the range seen, by which a frequency's own range exceeds it


def restrict_to_data(rules: CandidateRules, series: Sequence[Series]) -> CandidateRules:
    """Return `rules` with the range of each frequency narrowed to what `series` hold.

    Raises CesError for a hat that peaks, or a hysteresis that is wider, than the data reach. A lag whose time constant
    is open is taken to reach as far as its signal.
    """
    made = {
        name: tuple(_fit_to_data(one, series, rules.open_lags) for one in group)
        for name, group in rules.constructed.items()
    }
    return replace(rules, constructed=made)


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


def _narrow_range(one: Frequency, seen: F) -> Frequency:
    low, high = one.range_Hz
    margin = MARGIN * float(np.ptp(seen))
    narrow = max(low, float(seen.min()) - margin), min(high, float(seen.max()) + margin)
    if not narrow[0] < narrow[1]:
        raise CesError(
            f"{one.name}: the data never leave {seen.min():g} Hz; expected motion within {low:g}-{high:g} Hz"
        )
    return replace(one, range_Hz=narrow)


def _require_inside(hat: TriangularMembership, seen: F) -> None:
    if not seen.min() <= hat.peak <= seen.max():
        raise CesError(
            f"{hat.name}: peaks at {hat.of} {hat.peak:g}, outside the data's {seen.min():g} to {seen.max():g}; "
            "expected places between"
        )


def _require_narrow(one: Hysteresis, seen: F) -> None:
    if 2.0 * one.half_width >= np.ptp(seen):
        raise CesError(
            f"{one.name}: half width {one.half_width:g} spans all of the data's {one.of}, "
            f"{seen.min():g} to {seen.max():g}; expected a narrower hysteresis"
        )
