"""Figures 5.1 to 5.8 of the thesis: measured and simulated force over speed or over time.

A figure has the two plots of the thesis, above for a model of its procedure, below for ours. Measured force is blue and
the model's red, as there.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

mpl.use("Agg")
from matplotlib import pyplot as plt

from bench.small_png import save_small
from bench.thesis.costs import FOLDER, Evaluations, percent
from bench.thesis.models import NAMES, OURS, THESIS, load_named_experiment
from bench.thesis.rows import TIME, Panel, panels
from ces_identify.validation.evaluate import Evaluation
from ces_rig.drive.reg1 import Reg1

if TYPE_CHECKING:
    from matplotlib.axes import Axes

F = NDArray[np.float64]

MEASURED, SIMULATED, REFERENCE, ZERO = "#3465a4", "#d62728", "#2ca02c", "#888888"
CLOUD = 2500  # points of a speed-force plot of a sweep or of noise
LOOP_S = 0.75  # of a sine, drawn as a line over speed
STRETCH_S = 0.6  # of a plot over time
FROM_S = 10.0  # where both begin
MARGIN = 0.35  # of the measured range, within which a simulated force is drawn
COLOURS = 64
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
         "grid.color": "#dddddd", "grid.linewidth": 0.6, "axes.axisbelow": True}  # fmt: skip


def caption(pair: tuple[Panel, Panel]) -> str:
    """Return what the two plots of a figure show, in words."""
    first, second = (panel.row.title for panel in pair)
    return f"(a) {first}, (b) {'the same over time' if pair[1].kind == TIME else second}"


def draw_all(evaluations: Evaluations, folder: Path) -> None:
    """Draw the eight figures into `folder`."""
    for number, pair in panels().items():
        with plt.rc_context(STYLE):
            draw(pair, evaluations, folder / f"thesis_{number.replace('.', '_')}.png")


def draw(pair: tuple[Panel, Panel], evaluations: Evaluations, path: Path) -> None:
    """Draw one figure: a row of plots for each procedure."""
    wide = pair[1].kind == TIME
    figure, grid = plt.subplots(
        2, 2, figsize=(9.0, 6.4), width_ratios=(1.0, 1.6 if wide else 1.0), sharex="col", layout="constrained"
    )
    for axes, procedure in zip(grid, (THESIS, OURS), strict=True):
        for axis, panel, letter in zip(axes, pair, "ab", strict=True):
            evaluation = evaluations[panel.structure, procedure, panel.row]
            axis.set_title(f"({letter}) {panel.row.title}\n{_subtitle(procedure, evaluation)}", fontsize=9, loc="left")
            if evaluation is not None:
                _plot(axis, panel, evaluation)
    for axis, panel in zip(grid[-1], pair, strict=True):
        axis.set_xlabel("time [s]" if panel.kind == TIME else "speed [m/s], positive in compression")
    lines = {label: line for axis in grid.flat for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(lines.values(), lines.keys(), loc="outside upper right", ncols=3, frameon=False, fontsize=8)
    save_small(figure, path, COLOURS)


def _subtitle(procedure: str, evaluation: Evaluation | None) -> str:
    cost = percent(evaluation)
    return f"{NAMES[procedure]}: {f'J = {cost} %' if cost[0].isdigit() else cost}"


def _plot(axis: Axes, panel: Panel, evaluation: Evaluation) -> None:
    if panel.kind == TIME:
        _over_time(axis, evaluation)
    else:
        _over_speed(axis, evaluation, panel.row.target.startswith("sine"))
    if panel.with_reference:
        _draw_reference(axis, panel, evaluation)
    axis.axhline(0.0, color=ZERO, lw=0.7)
    axis.set_ylabel("force [kN]")
    _limit(axis, evaluation)


def _over_speed(axis: Axes, evaluation: Evaluation, as_line: bool) -> None:
    series = evaluation.series
    if as_line:
        chosen = _from(series.time_s, LOOP_S)
        line: dict[str, Any] = {"ls": "-", "lw": 1.0}
    else:
        chosen = np.random.default_rng(0).permutation(np.flatnonzero(series.scored))[:CLOUD]
        line = {"ls": "", "marker": ".", "ms": 2.0, "mew": 0}
    axis.plot(series.speed[chosen], series.force[chosen] / 1e3, color=MEASURED, label="measured", **line)
    axis.plot(series.speed[chosen], evaluation.run.force[chosen] / 1e3, color=SIMULATED, label="model", **line)
    axis.axvline(0.0, color=ZERO, lw=0.7)


def _over_time(axis: Axes, evaluation: Evaluation) -> None:
    series = evaluation.series
    chosen = _from(series.time_s, STRETCH_S)
    time = series.time_s[chosen]
    axis.plot(time, series.force[chosen] / 1e3, color=MEASURED, lw=1.4, label="measured")
    axis.plot(time, evaluation.run.force[chosen] / 1e3, color=SIMULATED, lw=1.0, label="model")
    axis.set_xlim(time[0], time[-1])


def _draw_reference(axis: Axes, panel: Panel, evaluation: Evaluation) -> None:
    reg1 = load_named_experiment(f"{FOLDER}/{panel.row.target}", fresh=True).current
    assert isinstance(reg1, Reg1)
    speeds = np.linspace(evaluation.series.speed.min(), evaluation.series.speed.max(), 200)
    forces = [reg1.reference.at(speed) / 1e3 for speed in speeds]
    axis.plot(speeds, forces, color=REFERENCE, lw=1.0, label="reference of reg1")


def _limit(axis: Axes, evaluation: Evaluation) -> None:
    """Limit the axis to the measured forces and a margin, so that an unstable run does not hide them."""
    scored = evaluation.series.scored
    measured, simulated = evaluation.series.force[scored] / 1e3, np.nan_to_num(evaluation.run.force[scored]) / 1e3
    low, high, margin = measured.min(), measured.max(), MARGIN * np.ptp(measured)
    axis.set_ylim(
        max(low - margin, min(1.05 * low, simulated.min())), min(high + margin, max(1.05 * high, simulated.max()))
    )


def _from(time_s: F, length_s: float) -> NDArray[np.bool_]:
    return np.asarray((time_s >= FROM_S) & (time_s <= FROM_S + length_s))
