"""The picture of force tracking: error by plant and feedback for each stroke, and one second of the closed loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt

from bench.force_tracking.loop import TrackedRun, TrackingResult
from bench.small_png import save_small

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {
    "none": "#8a8f98", "estimate": "#d9722e", "measured": "#3b6ea5", "anew none": "#c9a227", "anew estimate": "#2e8b57",
}  # fmt: skip
MARKERS = {"none": "s", "estimate": "o", "measured": "D", "anew none": "v", "anew estimate": "^"}
DESIRED, REACHABLE = "#222222", "#eef3ee"
SPREAD = 0.14  # of a row, between ways
PALETTE = 200
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
         "grid.color": "#e2e2e2", "grid.linewidth": 0.6, "axes.axisbelow": True}  # fmt: skip


def draw(
    figures: Sequence[TrackingResult],
    ways: Mapping[str, str],
    shown: Mapping[str, TrackedRun],
    window_s: tuple[float, float],
    path: Path,
) -> None:
    """Draw `figures` into `path`, with the part `window_s` of the runs `shown` by variant."""
    with plt.rc_context(STYLE):
        drawing = plt.figure(figsize=(9.6, 8.2), layout="constrained")
        upper, lower = drawing.subfigures(2, 1, height_ratios=(1.45, 1.0))
        strokes = list(dict.fromkeys(figure.stroke for figure in figures))
        axes = upper.subplots(1, len(strokes), sharey=True)
        for axis, stroke in zip(axes, strokes, strict=True):
            by_case(axis, [figure for figure in figures if figure.stroke == stroke], ways)
            axis.set_title(stroke, loc="left", fontsize=10)
        upper.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=3, frameon=False)
        over_time(lower, shown, ways, window_s)
        save_small(drawing, path, PALETTE)


def by_case(axis: Axes, figures: Sequence[TrackingResult], ways: Mapping[str, str]) -> None:
    """Draw a row for each plant with its variants: the median as a mark, all seeds as a line."""
    cases = list(dict.fromkeys(figure.case for figure in figures))
    for place, way in enumerate(ways):
        for row, case in enumerate(cases):
            costs = [figure.J for figure in figures if (figure.case, figure.way) == (case, way)]
            if costs:
                at = row + SPREAD * (place - (len(ways) - 1) / 2)
                label = ways[way] if case == most_complete(figures) else None
                axis.plot([min(costs), max(costs)], [at, at], color=COLOURS[way], lw=1.6, alpha=0.55)
                axis.plot(np.median(costs), at, MARKERS[way], color=COLOURS[way], ms=5.5, mew=0, label=label)
    axis.set_yticks(range(len(cases)), cases)
    axis.set_ylim(len(cases) - 0.5, -0.5)
    axis.grid(visible=False, axis="y")
    for edge in np.arange(len(cases) - 1) + 0.5:
        axis.axhline(edge, color="#e2e2e2", lw=0.6)
    axis.set_xlim(left=0.0)
    axis.set_xlabel("tracking error J [%]")


def most_complete(figures: Sequence[TrackingResult]) -> str:
    """Return the case that was run in the most variants."""
    return max(figures, key=lambda figure: len({f.way for f in figures if f.case == figure.case})).case


def over_time(
    drawing: Any, shown: Mapping[str, TrackedRun], ways: Mapping[str, str], window_s: tuple[float, float]
) -> None:
    """Draw desired and true forces, shaded where the damper could reach the desired force, and the currents below."""
    force, current = drawing.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
    any_run = next(iter(shown.values()))
    part = (any_run.time_s >= window_s[0]) & (any_run.time_s <= window_s[1])
    time = any_run.time_s[part]
    force.fill_between(
        time, 0, 1, where=any_run.reachable[part], transform=force.get_xaxis_transform(), color=REACHABLE, lw=0
    )
    force.plot(time, any_run.desired_N[part] / 1e3, color=DESIRED, lw=1.6, label="desired")
    for way, run in shown.items():
        force.plot(time, run.force_N[part] / 1e3, color=COLOURS[way], lw=1.2, label=ways[way])
        current.plot(time, run.command_A[part], color=COLOURS[way], lw=0.9)
    force.set_title(
        "noise stroke, the plant as identified; shaded: where the desired force can be had", loc="left", fontsize=10
    )
    force.set_ylabel("force [kN]")
    force.legend(loc="lower right", frameon=False, ncols=3, fontsize=8)
    current.set_ylabel("command [A]")
    current.set_xlabel("time [s]")
    current.set_xlim(*window_s)
