"""Costs as DataFrames: the columns of one evaluation, or of several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ces_data.reading import import_pandas
from ces_report.table import PrintedResult

SHOWN = (
    "cost", "coverage", "error", "floor", "half_width", "interval", "name", "outside_share", "rms_N", "role", "run",
    "scored_s", "series", "to_frame", "warnings",
)  # fmt: skip  # what docs/api.md says, and plain facts


class FramedResult(PrintedResult):
    """A cost that prints itself, and is a row of a DataFrame."""

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if name in SHOWN or name.startswith("_")]

    def to_frame(self) -> Any:
        """Return the cost as a DataFrame of one row: J with its interval [%], shares in percent."""
        return as_frame([self])


def as_frame(costs: Sequence[Any]) -> Any:
    """Return the costs as a DataFrame, a row for each."""
    rows = [
        {
            "recording": e.name,
            "role": e.role,
            "scored_s": e.scored_s,
            "J_percent": e.cost,
            "low_percent": e.interval.low if e.interval else math.nan,
            "high_percent": e.interval.high if e.interval else math.nan,
            "floor_percent": math.nan if e.floor is None else e.floor,
            "rms_N": e.rms_N,
            "outside_percent": 100.0 * e.outside_share,
            "band_percent": math.nan if e.coverage is None else 100.0 * e.coverage,
        }
        for e in costs
    ]
    return import_pandas().DataFrame(rows)
