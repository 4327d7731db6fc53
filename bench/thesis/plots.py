"""Figure 5.3 of the thesis: measured and simulated force over speed.

It has the two plots of the thesis, above for a model of its procedure, below for ours. Measured force is blue and
the model's red, as there. The speed is that of the recorded position, smoothed without delay; models use their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.signal import butter, sosfiltfilt

mpl.use("Agg")
from matplotlib import pyplot as plt

from bench.thesis.costs import Evaluations, percent
from bench.thesis.models import NAMES, OURS, POLYNOMIAL, TABLES, THESIS
from ces_identify.prepare.series import Series
from ces_identify.validation.evaluate import Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

F = NDArray[np.float64]

MEASURED, SIMULATED, ZERO = "#7aa6dc", "#c4161c", "#888888"
ROWS = TABLES[POLYNOMIAL].rows[-2:]  # a sine of 4 Hz on the models of the sweep and of the noise
FROM_S, LENGTH_S = 10.0, 0.75  # the part that is drawn
SMOOTHING_HZ = 40.0  # of the speed: well above any stroke, well below its noise
MARGIN = 0.35  # of the measured range, within which a simulated force is drawn
COLOURS = 64
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
         "grid.color": "#dddddd", "grid.linewidth": 0.6, "axes.axisbelow": True}  # fmt: skip


def draw(evaluations: Evaluations, path: Path) -> None:
    """Draw the figure: a row of plots for each procedure."""
    with plt.rc_context(STYLE):
        figure, grid = plt.subplots(2, 2, figsize=(9.0, 6.4), sharex="col", sharey="col", layout="constrained")
    shown = {p: [evaluations[POLYNOMIAL, p, row] for row in ROWS] for p in (THESIS, OURS)}
    for axes, (procedure, both) in zip(grid, shown.items(), strict=True):
        for axis, row, letter, evaluation in zip(axes, ROWS, "ab", both, strict=True):
            axis.set_title(f"({letter}) {row.title}\n{_subtitle(procedure, evaluation)}", fontsize=9, loc="left")
            if evaluation is not None:
                _plot(axis, evaluation)
    for axis, drawn in zip(grid[-1], zip(*shown.values(), strict=True), strict=True):
        axis.set_xlabel("speed [m/s], positive in compression")
        axis.set_ylim(*_force_limits([evaluation for evaluation in drawn if evaluation is not None]))
    lines = {label: line for axis in grid.flat for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    legend = figure.legend(lines.values(), lines.keys(), loc="outside upper right", ncols=2, frameon=False)
    for handle in legend.legend_handles:
        handle.set_linewidth(2.0)
    save_small(figure, path, COLOURS)


def _subtitle(procedure: str, evaluation: Evaluation | None) -> str:
    cost = percent(evaluation)
    return f"{NAMES[procedure]}: {f'J = {cost} %' if cost[0].isdigit() else cost}"


def _plot(axis: Axes, evaluation: Evaluation) -> None:
    series, speed = evaluation.series, smooth_speed(evaluation.series)
    chosen = (series.time_s >= FROM_S) & (series.time_s <= FROM_S + LENGTH_S)
    axis.plot(speed[chosen], series.force[chosen] / 1e3, color=MEASURED, label="measured", lw=2.6)
    axis.plot(speed[chosen], evaluation.run.force[chosen] / 1e3, color=SIMULATED, label="model", lw=1.0)
    axis.axvline(0.0, color=ZERO, lw=0.7)
    axis.axhline(0.0, color=ZERO, lw=0.7)
    axis.set_ylabel("force [kN]")


def smooth_speed(series: Series) -> F:
    """Return the speed [m/s] of the recorded position (n,), smoothed without delay."""
    sos = butter(4, SMOOTHING_HZ, fs=series.rate_Hz, output="sos")
    return np.gradient(sosfiltfilt(sos, series.position), 1.0 / series.rate_Hz)


def _force_limits(shown: Sequence[Evaluation]) -> tuple[float, float]:
    """Return limits [kN] around the measured forces, with a margin for those of the models, however large."""
    if not shown:
        return -1.0, 1.0
    scored = shown[0].series.scored
    measured = shown[0].series.force[scored] / 1e3
    simulated = np.nan_to_num(np.concatenate([e.run.force[e.series.scored] for e in shown])) / 1e3
    low, high, margin = measured.min(), measured.max(), MARGIN * np.ptp(measured)
    return max(low - margin, min(1.05 * low, simulated.min())), min(high + margin, max(1.05 * high, simulated.max()))


def save_small(figure: Figure, path: Path, colours: int) -> None:
    """Save and close a figure with few colours, a third of the size; the file appears only when it is complete."""
    pixels = BytesIO()
    figure.savefig(pixels, dpi=130)
    plt.close(figure)
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    Image.open(pixels).convert("RGB").quantize(colours, dither=Image.Dither.NONE).save(part, optimize=True)
    part.replace(path)
