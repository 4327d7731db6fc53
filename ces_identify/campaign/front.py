"""Which of a campaign's models to look at: the Pareto front of cost against parameters, and the one recommended.

Both go by the selection cost, which the search itself had; validation costs never choose, so that they stay honest.
Selection costs compare models of the same set of bags only: each set has its own front.
"""

from __future__ import annotations

from collections.abc import Sequence

from ces_identify.jobs.job import DONE
from ces_identify.jobs.row_log import Row

COST_TOLERANCE = 0.1  # of the lowest selection cost, relative: what a smaller model may cost


def front(rows: Sequence[Row]) -> list[Row]:
    """Return the rows that no other beats in both parameters and selection cost, smallest model first.

    All rows are of one set of bags. Models without a proof of stability count only if none has one.
    """
    best: list[Row] = []
    for row in sorted(_eligible(rows), key=lambda r: (r["parameters"], r["selection_J"])):
        if not best or row["selection_J"] < best[-1]["selection_J"]:
            best.append(row)
    return best


def recommend_model(rows: Sequence[Row]) -> Row | None:
    """Return the smallest model on the front within a tenth of its lowest cost, None if there is no model."""
    best = front(rows)
    return next((row for row in best if row["selection_J"] <= (1.0 + COST_TOLERANCE) * best[-1]["selection_J"]), None)


def _eligible(rows: Sequence[Row]) -> list[Row]:
    judged = [row for row in rows if row["status"] == DONE and row["selection_J"] is not None]
    return [row for row in judged if row["gain"] is not None] or judged
