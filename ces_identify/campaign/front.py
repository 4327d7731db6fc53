"""The Pareto front of a campaign's models, cost against parameters, and the recommended model.

Both use the search's selection cost; validation costs never choose a model, so that they remain independent. Selection
costs are comparable only for the same set of bags: each set has its own front.
"""

from __future__ import annotations

from collections.abc import Sequence

from ces_identify.jobs.job import DONE
from ces_identify.jobs.row_log import Row

COST_TOLERANCE = 0.1  # relative to the lowest selection cost: the excess allowed for a smaller model


def front(rows: Sequence[Row], size: str = "parameters") -> list[Row]:
    """Return the rows that no other beats in both `size` (a column) and selection cost, smallest model first.

    All rows belong to one set of bags. Models without a certificate count only if none has one.
    """
    best: list[Row] = []
    models = [row for row in rows if row["status"] == DONE and row["selection_J"] is not None]
    models = [row for row in models if is_proved(row)] or models
    for row in sorted(models, key=lambda r: (r[size], r["selection_J"])):
        if not best or row["selection_J"] < best[-1]["selection_J"]:
            best.append(row)
    return best


def is_proved(row: Row) -> bool:
    """Return whether the row's model has a certificate; rows of older campaigns hold a contraction's gain alone."""
    return row.get("force_bound_N") is not None or row["gain"] is not None


def recommend_model(rows: Sequence[Row]) -> Row | None:
    """Return the smallest model on the front within 10 % of its lowest cost, None if there is no model."""
    best = front(rows)
    return next((row for row in best if row["selection_J"] <= (1.0 + COST_TOLERANCE) * best[-1]["selection_J"]), None)
