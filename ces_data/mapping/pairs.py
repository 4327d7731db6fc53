"""Candidates in pairs: how the numbers of one go with those of another, or with the speed that it would have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.limits import RatingLimits, StatisticLimits
from ces_data.mapping.rating import Candidate
from ces_data.recording import Values

BIN_S, MAX_BINS = 0.005, 100_000
UNIT_RATIOS = (1.0, 1e-3, 1e3, 1e-2, 1e2)


class MotionTable:
    """Candidates, with distinct labels, averaged over time bins."""

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        self._start = min(int(c.stamps_ns.min()) for c in candidates) if candidates else 0
        self._end = max(int(c.stamps_ns.max()) for c in candidates) if candidates else 0
        self._bins: dict[tuple[str, float], Values] = {}

    def correlate(self, stroke: Candidate, other: Candidate) -> tuple[float, float]:
        """Return the correlation (-1 to 1) of `other` with the derivative of `stroke`, and its gain; NaN if unknown."""
        width = self._width(stroke)
        place = self._averages(stroke, width)
        speed = np.full(len(place), np.nan)
        speed[1:-1] = (place[2:] - place[:-2]) / (2.0 * width)
        values = self._averages(other, width)
        return _correlate(speed, values)

    def correlate_values(self, candidate: Candidate, other: Candidate) -> tuple[float, float]:
        """Return the correlation (-1 to 1) of `other` with `one`, and its gain; NaN if unknown."""
        width = max(self._width(candidate), self._width(other))
        return _correlate(self._averages(candidate, width), self._averages(other, width))

    def is_derivative(self, stroke: Candidate, other: Candidate) -> bool:
        """Return whether `other` is the speed of `stroke`, up to sign and unit."""
        correlation, gain = self.correlate(stroke, other)
        if not abs(correlation) >= RatingLimits.EXACT:
            return False
        if stroke.unit and other.unit:
            return other.unit.quantity == "speed"
        return any(abs(abs(gain) / ratio - 1.0) < RatingLimits.UNIT_TOLERANCE for ratio in UNIT_RATIOS)

    def is_same(self, candidate: Candidate, other: Candidate) -> bool:
        """Return whether two candidates hold the same motion, such as a command and the position that follows it."""
        return bool(abs(self.correlate_values(candidate, other)[0]) > RatingLimits.SAME_MOTION)

    def _width(self, candidate: Candidate) -> float:
        """Return the width of the bins [s] for a candidate: 5 ms times a power of two, at least two samples."""
        needed = max(2.0 / candidate.rate_Hz if candidate.rate_Hz else 1.0, (self._end - self._start) / 1e9 / MAX_BINS)
        return float(BIN_S * 2.0 ** max(0.0, np.ceil(np.log2(needed / BIN_S))))

    def _averages(self, candidate: Candidate, width: float) -> Values:
        key = (candidate.label, width)
        if key not in self._bins:
            count = int((self._end - self._start) / (width * 1e9)) + 1
            good = np.isfinite(candidate.values)
            at = ((candidate.stamps_ns[good] - self._start) / (width * 1e9)).astype(np.int64)
            number = np.bincount(at, minlength=count)
            total = np.bincount(at, candidate.values[good], minlength=count)
            self._bins[key] = np.where(number > 0, total / np.maximum(number, 1), np.nan)
        return self._bins[key]


def _correlate(values: Values, other: Values) -> tuple[float, float]:
    """Return correlation and gain of `other` over `one`, both (n,), where both are known; NaN if that cannot be."""
    both = np.isfinite(values) & np.isfinite(other)
    if both.sum() < StatisticLimits.ENOUGH:
        return np.nan, np.nan
    a, b = values[both] - values[both].mean(), other[both] - other[both].mean()
    power, size = float(a @ a), float(b @ b)
    if power == 0.0 or size == 0.0:
        return np.nan, np.nan
    return float(a @ b) / np.sqrt(power * size), float(a @ b) / power
