"""Faults of a recording that only a model of the same damper shows: another unit of force, both signs reversed.

Measured and simulated forces in, findings out. A single recording in lbf, or with position and force both reversed, is
that of another sound damper; beside a model it is not.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.recordings.checks import WRONG_MODEL, Finding
from ces_identify.sense.force_ratio import UNITS, find_unit

MIN_CORRELATION = 0.85  # of both forces, from which on their ratio counts
MIN_ERROR, CLEARLY = 0.2, 0.5  # relative error that both signs reversed must at least halve


def unit_against_model(measured: F, simulated: F) -> Iterator[Finding]:
    """Yield a finding if the measured force (n,) is the simulated one in another unit."""
    if measured.std() == 0.0 or simulated.std() == 0.0 or _correlation(measured, simulated) < MIN_CORRELATION:
        return
    slope = float(measured.std() / simulated.std())
    unit = find_unit(slope)
    if unit is not None and slope < 1.0:
        yield Finding(
            WRONG_MODEL,
            f"force: {slope:.3g} times as large as the model's; if it is in {unit}, multiply its scale in the signals "
            f"file by {UNITS[unit]:.6g}",
            signal="force",
        )
    elif unit is not None:
        yield Finding(
            WRONG_MODEL,
            f"force: {slope:.3g} times as large as the model's; if the model was identified in {unit}, multiply the "
            f"scale of the force by {UNITS[unit]:.6g} in the signals file it was identified with, and identify again",
            signal="force",
        )


def signs_against_model(cost: float, reversed_cost: float) -> Iterator[Finding]:
    """Yield a finding if a model follows a recording better by far with position and force both reversed.

    The costs J [%] are those of its free runs on the recording as it is, and reversed. A damper that acts alike in
    compression and rebound shows no difference, and needs none.
    """
    if cost > 100.0 * MIN_ERROR and reversed_cost < CLEARLY * cost:
        yield Finding(
            WRONG_MODEL,
            f"position and force: the model follows them better with both signs reversed (J {reversed_cost:.0f} "
            f"instead of {cost:.0f} %); both are positive in compression: multiply both scales by -1 in the signals "
            "file of the recording, or identify the model again if its own was wrong",
        )


def _correlation(a: F, b: F) -> float:
    return float(np.corrcoef(a, b)[0, 1])
