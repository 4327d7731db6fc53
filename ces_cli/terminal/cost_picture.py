"""Measured and simulated force as an image file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ces_cli.terminal.coverage_picture import write_picture
from ces_identify.validation.evaluate import Evaluation


def save_cost_picture(evaluations: Sequence[Evaluation], path: Path) -> None:
    """Draw the first evaluations, validation first, into an image file that appears only when it is complete."""
    import matplotlib as mpl

    mpl.use("Agg")
    from ces_identify.report.cost_figure import draw_costs

    write_picture(draw_costs(evaluations), path)
