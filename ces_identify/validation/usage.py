"""What each second of each recording served: estimation, selection, or test.

The test seconds enter no choice: neither the differentiator's, nor the terms', nor their number, nor the envelope's.
The statement goes into a model's provenance, from where tables and the report tell it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ces_identify.numerics.arrays import B
from ces_identify.polynomial.problem import BLOCK_S, ESTIMATION_BLOCKS, PERIOD_BLOCKS, estimation_ticks
from ces_identify.preparation.series import Series

RULE = (
    f"of every {PERIOD_BLOCKS * BLOCK_S:g} s identified on, the first {ESTIMATION_BLOCKS * BLOCK_S:g} s serve "
    f"estimation and the last {(PERIOD_BLOCKS - ESTIMATION_BLOCKS) * BLOCK_S:g} s selection; a last fit may use both; "
    "nothing of the test seconds entered a choice"
)


def usage(identified: Sequence[Series], held_out: Sequence[Series]) -> list[dict[str, Any]]:
    """Return a row for each series: from when to when [s], and its scored seconds of each kind.

    `identified` are the series identified on, `held_out` those the model was only judged on.
    """
    rows = [_row(series, estimation_ticks(series)) for series in identified]
    return rows + [_row(series, None) for series in held_out]


def _row(series: Series, estimation: B | None) -> dict[str, Any]:
    scored, tick_s = series.scored, 1.0 / series.rate_Hz

    def seconds(ticks: B) -> float:
        return round(float(ticks.sum()) * tick_s, 1)

    nothing = np.zeros(len(series), bool)
    return {
        "recording": series.name,
        "from_s": round(float(series.time_s[0]), 2),
        "to_s": round(float(series.time_s[-1]), 2),
        "estimation_s": seconds(scored & (nothing if estimation is None else estimation)),
        "selection_s": seconds(scored & (nothing if estimation is None else ~estimation)),
        "test_s": seconds(scored if estimation is None else nothing),
    }
