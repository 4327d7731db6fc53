"""Forces of several recordings at equal speeds and currents: a ratio that is that of two units, such as lbf to N.

One damper gives about one force at one speed and current: on recordings of one damper, on different strokes and at
other temperatures, we found ratios of 0.6 to 1.5. Where the forces of two recordings lie on one line with about the
slope of a unit, one of them is probably in that unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding
from ces_identify.recordings.recording import Recording
from ces_identify.sense.force_map import is_constant
from ces_identify.sense.motion import Motion, recorded_motion

UNITS = {"kN": 1e3, "lbf": 4.4482216, "kgf": 9.80665}  # [N]
NEAR = 1.35  # largest ratio of a slope to that of a unit
MIN_CORRELATION, MIN_CELLS, MIN_TICKS = 0.85, 12, 15
SPEEDS, CURRENTS = 12, 4  # cells, over the range that all recordings share


def ratio_findings(recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Yield a finding for each recording whose forces are in another unit than those of the first."""
    motions = [(r.name, m) for r in recordings if (m := recorded_motion(r)) is not None]
    for name, motion in motions[1:]:
        first, reference = motions[0]
        slope = _slope(reference, motion)
        unit = find_unit(slope)
        if unit:
            small, large = (name, first) if slope < 1.0 else (first, name)
            known = not (is_constant(motion.current) or is_constant(reference.current))
            yield Finding(
                WRONG_MODEL if known else WARNING,  # without a current, the valve may have been set differently
                f"force: {max(slope, 1.0 / slope):.3g} times as large in {large} as in {small} at equal "
                f"speeds and currents; if {small} is in {unit}, multiply its scale in the signals file by "
                f"{UNITS[unit]:.6g}",
                signal="force",
            )


def find_unit(slope: float) -> str | None:
    """Return the unit whose ratio to N, or N's to it, a slope is."""
    for unit, newtons in UNITS.items():
        for ratio in (newtons, 1.0 / newtons):
            if 1.0 / NEAR < slope / ratio < NEAR:
                return unit
    return None


def _slope(first: Motion, other: Motion) -> float:
    """Return by what the forces of `other` exceed those of `first` in the cells of both; NaN if they are unlike."""
    edges = [
        np.linspace(max(a.min(), b.min()), min(a.max(), b.max()), cells + 1)
        for a, b, cells in ((first.speed, other.speed, SPEEDS), (first.current, other.current, CURRENTS))
    ]
    if np.ptp(edges[0]) <= 0.0 or edges[1][0] > edges[1][-1]:
        return np.nan
    x, y = (_cell_means(motion, *edges) for motion in (first, other))
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < MIN_CELLS or x[both].std() == 0.0 or y[both].std() == 0.0:
        return np.nan
    correlation = float(np.corrcoef(x[both], y[both])[0, 1])
    return float(y[both].std() / x[both].std()) if correlation > MIN_CORRELATION else np.nan


def _cell_means(motion: Motion, speeds: F, currents: F) -> F:
    """Return the mean force [N] in each cell of speed and current, NaN in cells with few ticks."""
    inside = (motion.speed >= speeds[0]) & (motion.speed < speeds[-1])
    if np.ptp(currents) > 0.0:
        inside &= (motion.current >= currents[0]) & (motion.current < currents[-1])
    rows = np.clip(np.searchsorted(speeds, motion.speed[inside], side="right") - 1, 0, SPEEDS - 1)
    columns = np.clip(np.searchsorted(currents, motion.current[inside], side="right") - 1, 0, CURRENTS - 1)
    cells = rows * CURRENTS + columns
    count = np.bincount(cells, minlength=SPEEDS * CURRENTS)
    total = np.bincount(cells, motion.force[inside], minlength=SPEEDS * CURRENTS)
    return np.where(count >= MIN_TICKS, total / np.maximum(count, 1), np.nan)
