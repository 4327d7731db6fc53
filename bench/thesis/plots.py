"""Plots 5.1 to 5.8: measured and simulated force over speed and over time, a row for each recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

mpl.use("Agg")
from matplotlib import pyplot as plt

from bench.small_png import save_small
from bench.thesis.models import ANFIS, BY_THESIS, NETWORK, OURS, POLYNOMIAL, THESIS, Evaluations, ThesisRow
from ces_cli.terminal.tables import percent
from ces_identify.report.cost_figure import MEASURED, SIMULATED
from ces_identify.report.window import choose_window
from ces_identify.validation.evaluate import Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

F = NDArray[np.float64]

CLOUD = 2500  # points of a speed-force plot
OTHER, ZERO = "#777777", "#888888"
LENGTH_S = 0.75  # of the stretch over time
COLOURS = 48
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
         "grid.color": "#dddddd", "grid.linewidth": 0.6, "axes.axisbelow": True}  # fmt: skip


def draw_all(evaluations: Evaluations, folder: Path) -> None:
    """Draw the eight figures into `folder`; rows without a model of this project are omitted."""
    rows = list(dict.fromkeys(row for _, _, row in evaluations))
    for number, (structure, chosen) in figures(rows).items():
        shown = {}
        for row in chosen:
            ours = evaluations[structure, OURS, row]
            if ours is not None:
                shown[row] = ours, evaluations[structure, THESIS, row]
        if shown:
            with plt.rc_context(STYLE):
                draw(shown, BY_THESIS[structure], folder / f"thesis_5_{number}.png")


def figures(rows: Sequence[ThesisRow]) -> dict[int, tuple[str, Sequence[ThesisRow]]]:
    """Return structure and rows of each figure."""
    own, across = rows[:3], rows[3:]
    single = {i + 1: (POLYNOMIAL, own[i : i + 1]) for i in range(3)}
    return {
        **single,
        4: (POLYNOMIAL, across),
        5: (NETWORK, own),
        6: (NETWORK, across),
        7: (ANFIS, own),
        8: (ANFIS, across),
    }


def draw(shown: Mapping[ThesisRow, tuple[Evaluation, Evaluation | None]], by_thesis: str, path: Path) -> None:
    """Draw a row of plots for each row of a table: our model beside that of the procedure `by_thesis`."""
    figure = plt.figure(figsize=(9.0, 3.1 * len(shown) + 0.4), layout="constrained")
    grid = figure.add_gridspec(2 * len(shown), 2, width_ratios=(1, 2), height_ratios=(2.2, 1.0) * len(shown))
    for i, (row, (ours, other)) in enumerate(shown.items()):
        left = figure.add_subplot(grid[2 * i : 2 * i + 2, 0])
        upper = figure.add_subplot(grid[2 * i, 1])
        lower = figure.add_subplot(grid[2 * i + 1, 1], sharex=upper)
        speed_force(left, ours)
        over_time(upper, lower, {by_thesis: other, "ours": ours})
        upper.set_title(title(row, ours, by_thesis, other), fontsize=9, loc="left")
    left.set_xlabel("speed [m/s], positive in compression")
    lower.set_xlabel("time [s]")
    lines = upper.get_legend_handles_labels()
    figure.legend(*lines, loc="outside upper right", ncols=3, frameon=False, fontsize=8)
    save_small(figure, path, COLOURS)


def title(row: ThesisRow, ours: Evaluation, by_thesis: str, other: Evaluation | None) -> str:
    theirs = percent(other.cost) + " %" if other else "no stable model"
    return f"{row.title}: J = {percent(ours.cost)} % ({by_thesis}: {theirs})"


def speed_force(axis: Axes, ours: Evaluation) -> None:
    ticks = np.flatnonzero(ours.series.scored)
    some = np.random.default_rng(0).permutation(ticks)[:CLOUD]
    for force, colour in ((ours.series.force, MEASURED), (ours.run.force, SIMULATED)):
        axis.plot(ours.series.speed[some], force[some] / 1e3, ".", ms=1.8, mew=0, color=colour)
    axis.axhline(0.0, color=ZERO, lw=0.7)
    axis.axvline(0.0, color=ZERO, lw=0.7)
    axis.set_ylabel("force [kN]")


def over_time(upper: Axes, lower: Axes, shown: Mapping[str, Evaluation | None]) -> None:
    """Draw forces and, below, errors where the error of our model, the last of `shown`, is typical."""
    *_, ours = filter(None, shown.values())
    low = ours.series.time_s[choose_window(ours).start]
    time, force, _ = stretch(ours, low)
    upper.plot(time, force, color=MEASURED, lw=1.8, label="measured")
    for (name, evaluation), (colour, line) in zip(shown.items(), ((OTHER, ":"), (SIMULATED, "-")), strict=True):
        if evaluation is not None:
            time, force, simulated = stretch(evaluation, low)
            upper.plot(time, simulated, line, color=colour, lw=1.1, label=f"{name}, free run")
            lower.plot(time, force - simulated, line, color=colour, lw=1.1)
    lower.axhline(0.0, color=ZERO, lw=0.7)
    lower.set_ylabel("error [kN]")
    upper.tick_params(labelbottom=False)
    upper.set_xlim(low, low + LENGTH_S)


def stretch(evaluation: Evaluation, low: float) -> tuple[F, F, F]:
    """Return times [s], measured and simulated force [kN] from `low` on."""
    series = evaluation.series
    near = (series.time_s >= low) & (series.time_s <= low + LENGTH_S)
    return series.time_s[near], series.force[near] / 1e3, evaluation.run.force[near] / 1e3
