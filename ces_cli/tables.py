"""Tables of costs for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.table import Table

from ces_identify.evaluate import Evaluation


def cost_table(evaluations: Sequence[Evaluation], title: str) -> Table:
    """Return a table with a row for each evaluation."""
    table = Table(title=title, title_justify="left", header_style="bold")
    table.add_column("recording", overflow="fold")
    table.add_column("seen by")
    for heading in ("scored s", "J %", "RMS N", "outside %"):
        table.add_column(heading, justify="right")
    for e in evaluations:
        table.add_row(
            e.name,
            "fit, selection" if e.role == "identification" else "nothing",
            f"{e.series.scored.sum() / e.series.rate_Hz:.1f}",
            percent(e.cost),
            f"{e.rms_N:.1f}" if math.isfinite(e.rms_N) else "-",
            f"{100 * e.clamped_share:.1f}",
        )
    return table


def percent(cost: float) -> str:
    """Return a cost J as text; a run that left its force envelope has none."""
    return f"{cost:.2f}" if math.isfinite(cost) else "diverged"
