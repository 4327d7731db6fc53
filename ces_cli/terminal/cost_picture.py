"""Measured against simulated force as a picture: speed-force and time plots, a row for each recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ces_cli.terminal.coverage_picture import style_axis, write_picture
from ces_cli.terminal.tables import interval_text, percent
from ces_identify.report.window import choose_window
from ces_identify.validation.cost_interval import cost_interval
from ces_identify.validation.evaluate import VALIDATION, Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_ROWS = 6
CLOUD = 4000  # points of a speed-force plot
MEASURED, SIMULATED = "#3b6ea5", "#d9722e"


def save_cost_picture(evaluations: Sequence[Evaluation], path: Path) -> None:
    """Draw the first recordings, validation first, into an image file."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    shown = sorted(evaluations, key=lambda e: e.role != VALIDATION)[:MAX_ROWS]
    figure, axes = plt.subplots(
        len(shown), 2, figsize=(9.0, 2.6 * len(shown) + 0.3), width_ratios=(1, 2), squeeze=False, layout="constrained"
    )
    for (left, right), evaluation in zip(axes, shown, strict=True):
        _speed_force(left, evaluation)
        _time(right, evaluation)
    for axis, label in zip(axes[-1], ("speed [m/s], positive in compression", "time [s]"), strict=True):
        axis.set_xlabel(label)
    figure.legend(
        *axes[0, 1].get_legend_handles_labels(), loc="outside upper right", ncols=2, frameon=False, fontsize=8
    )
    write_picture(figure, path)


def _speed_force(axis: Axes, evaluation: Evaluation) -> None:
    ticks = np.flatnonzero(evaluation.series.scored)
    some = np.random.default_rng(0).permutation(ticks)[:CLOUD]
    speed = evaluation.series.speed[some]
    axis.plot(speed, evaluation.series.force[some], ".", ms=1.5, color=MEASURED, rasterized=True)
    axis.plot(speed, evaluation.run.force[some], ".", ms=1.5, color=SIMULATED, rasterized=True)
    axis.set_ylabel("force [N]")
    style_axis(axis)


def _time(axis: Axes, evaluation: Evaluation) -> None:
    window = choose_window(evaluation)
    ticks = slice(window.start, window.stop)
    time = evaluation.series.time_s[ticks]
    axis.plot(time, evaluation.series.force[ticks], color=MEASURED, lw=1.4, label="measured")
    axis.plot(time, evaluation.run.force[ticks], color=SIMULATED, lw=1.1, label="simulated (free run)")
    interval = cost_interval([evaluation])
    bounds = f" ({interval_text(interval)})" if interval else ""
    title = f"{evaluation.name}, {evaluation.role}: J = {percent(evaluation.cost)} %{bounds}"
    axis.set_title(title, fontsize=9, loc="left")
    style_axis(axis)
