"""Measured and simulated force as a matplotlib figure: speed-force and time plots, a row for each recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ces_identify.report.window import choose_window
from ces_identify.validation.cost_interval import cost_interval
from ces_identify.validation.evaluate import VALIDATION, Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_ROWS = 6
CLOUD = 4000  # points of a speed-force plot
MEASURED, SIMULATED = "#3b6ea5", "#d9722e"


def draw_costs(evaluations: Sequence[Evaluation]) -> Figure:
    """Return a figure of the first evaluations, validation first."""
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
    return figure


def _speed_force(axis: Axes, evaluation: Evaluation) -> None:
    ticks = np.flatnonzero(evaluation.series.scored)
    some = np.random.default_rng(0).permutation(ticks)[:CLOUD]
    speed = evaluation.series.speed[some]
    axis.plot(speed, evaluation.series.force[some], ".", ms=1.5, color=MEASURED, rasterized=True)
    axis.plot(speed, evaluation.run.force[some], ".", ms=1.5, color=SIMULATED, rasterized=True)
    axis.set_ylabel("force [N]")
    _plain(axis)


def _time(axis: Axes, evaluation: Evaluation) -> None:
    window = choose_window(evaluation)
    ticks = slice(window.start, window.stop)
    time = evaluation.series.time_s[ticks]
    axis.plot(time, evaluation.series.force[ticks], color=MEASURED, lw=1.4, label="measured")
    axis.plot(time, evaluation.run.force[ticks], color=SIMULATED, lw=1.1, label="simulated (free run)")
    role = "validation" if evaluation.role == VALIDATION else "identification"
    interval = cost_interval([evaluation])
    bounds = f" ({interval.low:.2f}-{interval.high:.2f})" if interval else ""
    cost = f"{evaluation.cost:.2f}" if np.isfinite(evaluation.cost) else "diverged"
    axis.set_title(f"{evaluation.name}, {role}: J = {cost} %{bounds}", fontsize=9, loc="left")
    _plain(axis)


def _plain(axis: Axes) -> None:
    axis.grid(alpha=0.25, lw=0.6)
    axis.spines[["top", "right"]].set_visible(False)
    axis.tick_params(labelsize=8)
