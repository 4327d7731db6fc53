"""Figures 5.1 to 5.8 of the thesis: measured and simulated force over speed or over time.

A figure has the two plots of the thesis, above for a model of its procedure, below for ours. Measured force is blue and
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

from bench.thesis.costs import FOLDER, Evaluations, percent
from bench.thesis.models import NAMES, OURS, THESIS, TIME, ThesisPanel, load_named_experiment, panels
from ces_identify.prepare.series import Series
from ces_identify.validation.evaluate import Evaluation
from ces_rig.drive.currents import Reg1

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

F = NDArray[np.float64]

MEASURED, SIMULATED, REFERENCE, ZERO = "#7aa6dc", "#c4161c", "#2ca02c", "#888888"
CLOUD = 2500  # points of a speed-force plot of a sweep or of noise
LOOP_S = 0.75  # of a sine, drawn as a line over speed
STRETCH_S = 0.6  # of a plot over time
FROM_S = 10.0  # where both begin
SMOOTHING_HZ = 40.0  # of the speed: well above any stroke, well below its noise
MARGIN = 0.35  # of the measured range, within which a simulated force is drawn
COLOURS = 64
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
         "grid.color": "#dddddd", "grid.linewidth": 0.6, "axes.axisbelow": True}  # fmt: skip


def caption(pair: tuple[ThesisPanel, ThesisPanel]) -> str:
    """Return what the two plots of a figure show, in words."""
    first, second = (panel.row.title for panel in pair)
    return f"(a) {first}, (b) {'the same over time' if pair[1].kind == TIME else second}"


def draw_all(evaluations: Evaluations, folder: Path) -> None:
    """Draw the eight figures into `folder`."""
    for number, pair in panels().items():
        with plt.rc_context(STYLE):
            draw(pair, evaluations, folder / f"thesis_{number.replace('.', '_')}.png")


def draw(pair: tuple[ThesisPanel, ThesisPanel], evaluations: Evaluations, path: Path) -> None:
    """Draw one figure: a row of plots for each procedure."""
    widths = (1.0, 1.6 if pair[1].kind == TIME else 1.0)
    figure, grid = plt.subplots(
        2, 2, figsize=(9.0, 6.4), width_ratios=widths, sharex="col", sharey="col", layout="constrained"
    )
    shown = {p: [evaluations[panel.structure, p, panel.row] for panel in pair] for p in (THESIS, OURS)}
    for axes, (procedure, both) in zip(grid, shown.items(), strict=True):
        for axis, panel, letter, evaluation in zip(axes, pair, "ab", both, strict=True):
            axis.set_title(f"({letter}) {panel.row.title}\n{_subtitle(procedure, evaluation)}", fontsize=9, loc="left")
            if evaluation is not None:
                _plot(axis, panel, evaluation)
    for axis, panel, drawn in zip(grid[-1], pair, zip(*shown.values(), strict=True), strict=True):
        axis.set_xlabel("time [s]" if panel.kind == TIME else "speed [m/s], positive in compression")
        axis.set_ylim(*_force_limits([evaluation for evaluation in drawn if evaluation is not None]))
    lines = {label: line for axis in grid.flat for line, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    legend = figure.legend(
        lines.values(), lines.keys(), loc="outside upper right", ncols=3, frameon=False, markerscale=3
    )
    for handle in legend.legend_handles:
        handle.set_linewidth(2.0)
    save_small(figure, path, COLOURS)


def _subtitle(procedure: str, evaluation: Evaluation | None) -> str:
    cost = percent(evaluation)
    return f"{NAMES[procedure]}: {f'J = {cost} %' if cost[0].isdigit() else cost}"


def _plot(axis: Axes, panel: ThesisPanel, evaluation: Evaluation) -> None:
    if panel.kind == TIME:
        _over_time(axis, evaluation)
    else:
        _over_speed(axis, evaluation, panel.row.target.startswith("sine"))
    if panel.with_reference:
        _draw_reference(axis, panel, evaluation)
    axis.axhline(0.0, color=ZERO, lw=0.7)
    axis.set_ylabel("force [kN]")


def _over_speed(axis: Axes, evaluation: Evaluation, as_line: bool) -> None:
    series, speed = evaluation.series, _smooth_speed(evaluation.series)
    forces = {"measured": (series.force, MEASURED), "model": (evaluation.run.force, SIMULATED)}
    if as_line:
        chosen = _from(series.time_s, LOOP_S)
    else:
        chosen = np.random.default_rng(0).permutation(np.flatnonzero(series.scored))[:CLOUD]
    for (label, (force, colour)), size in zip(forces.items(), (2.6, 1.0), strict=True):
        line = {"lw": size} if as_line else {"ls": "", "marker": ".", "ms": 1.6 * size, "mew": 0}
        axis.plot(speed[chosen], force[chosen] / 1e3, color=colour, label=label, **line)
    axis.axvline(0.0, color=ZERO, lw=0.7)


def _smooth_speed(series: Series) -> F:
    sos = butter(4, SMOOTHING_HZ, fs=series.rate_Hz, output="sos")
    return np.gradient(sosfiltfilt(sos, series.position), 1.0 / series.rate_Hz)


def _over_time(axis: Axes, evaluation: Evaluation) -> None:
    series = evaluation.series
    chosen = _from(series.time_s, STRETCH_S)
    time = series.time_s[chosen]
    axis.plot(time, series.force[chosen] / 1e3, color=MEASURED, lw=2.6, label="measured")
    axis.plot(time, evaluation.run.force[chosen] / 1e3, color=SIMULATED, lw=1.0, label="model")
    axis.set_xlim(time[0], time[-1])


def _draw_reference(axis: Axes, panel: ThesisPanel, evaluation: Evaluation) -> None:
    reg1 = load_named_experiment(f"{FOLDER}/{panel.row.target}", fresh=True).current
    assert isinstance(reg1, Reg1)
    speeds = np.linspace(evaluation.series.speed.min(), evaluation.series.speed.max(), 200)
    forces = [reg1.reference.at(speed) / 1e3 for speed in speeds]
    axis.plot(speeds, forces, color=REFERENCE, lw=1.0, label="reference of reg1")


def _force_limits(shown: Sequence[Evaluation]) -> tuple[float, float]:
    """Return limits [kN] around the measured forces, with a margin for those of the models, however large."""
    if not shown:
        return -1.0, 1.0
    scored = shown[0].series.scored
    measured = shown[0].series.force[scored] / 1e3
    simulated = np.nan_to_num(np.concatenate([e.run.force[e.series.scored] for e in shown])) / 1e3
    low, high, margin = measured.min(), measured.max(), MARGIN * np.ptp(measured)
    return max(low - margin, min(1.05 * low, simulated.min())), min(high + margin, max(1.05 * high, simulated.max()))


def _from(time_s: F, length_s: float) -> NDArray[np.bool_]:
    return np.asarray((time_s >= FROM_S) & (time_s <= FROM_S + length_s))


def save_small(figure: Figure, path: Path, colours: int) -> None:
    """Save and close a figure with few colours, a third of the size; the file appears only when it is complete."""
    pixels = BytesIO()
    figure.savefig(pixels, dpi=130)
    plt.close(figure)
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    Image.open(pixels).convert("RGB").quantize(colours, dither=Image.Dither.NONE).save(part, optimize=True)
    part.replace(path)
