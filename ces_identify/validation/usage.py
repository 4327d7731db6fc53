"""The use of each second of each recording, for a model's provenance: estimation, selection or test.

The test seconds affect no choice: neither differentiator, terms, number of terms nor envelope.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ces_identify.numerics.arrays import Mask
from ces_identify.polynomial.problem import BLOCK_S, ESTIMATION_BLOCKS, PERIOD_BLOCKS, estimation_ticks
from ces_identify.preparation.series import Series

RULE = (
    f"of every {PERIOD_BLOCKS * BLOCK_S:g} s of identification data, the first {ESTIMATION_BLOCKS * BLOCK_S:g} s serve "
    f"estimation and the last {(PERIOD_BLOCKS - ESTIMATION_BLOCKS) * BLOCK_S:g} s selection; a last fit may use both; "
    "no choice used the test seconds"
)


def usage(identified: Sequence[Series], held_out: Sequence[Series]) -> list[dict[str, Any]]:
    """Return a row for each series: its start and end [s], and its scored seconds of each kind."""
    rows = [_row(series, estimation_ticks(series)) for series in identified]
    return rows + [_row(series, None) for series in held_out]


def _row(series: Series, estimation: Mask | None) -> dict[str, Any]:
    scored, none = series.scored, np.zeros(len(series), bool)
    masks = (none, none, scored) if estimation is None else (scored & estimation, scored & ~estimation, none)
    seconds = [round(float(mask.sum()) * (1.0 / series.rate_Hz), 1) for mask in masks]
    return {
        "recording": series.name,
        "from_s": round(float(series.time_s[0]), 2),
        "to_s": round(float(series.time_s[-1]), 2),
        **dict(zip(("estimation_s", "selection_s", "test_s"), seconds, strict=True)),
    }
