"""A campaign as a picture: selection cost against number of parameters, one panel with its front per set of bags."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ces_cli.campaign.tables import Summary, mean_cost
from ces_cli.terminal.coverage_picture import style_axis, write_picture
from ces_identify.campaign.front import front, is_proved, recommend_model
from ces_identify.jobs.job import DONE
from ces_identify.jobs.row_log import Row
from ces_identify.structures import KITS
from ces_identify.structures.polynomial import POLYNOMIAL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOOKS = (("#3b6ea5", "o"), ("#d9722e", "s"), ("#4f8a4c", "^"), ("#8a4c7d", "D"), ("#9a8432", "v"), ("#2f8c8c", "P"))
LOOK = dict(zip(KITS, cycle(LOOKS), strict=False))
INK, PALE = "#333333", "#8a8a8a"
MAX_COLUMNS = 3
LOG_RATIO = 8.0  # ratio of largest to smallest above which an axis is logarithmic


def save_pareto_picture(summary: Summary, path: Path) -> None:
    """Draw the picture into a file."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    names = [name for name in summary.bags if any(row["status"] == DONE for row in summary.of_bags(name))]
    columns = min(MAX_COLUMNS, len(names))
    lines = -(-len(names) // columns)
    size = (max(7.2, 4.6 * columns), 3.7 * lines + 0.9)
    with mpl.rc_context({"svg.hashsalt": "ces", "svg.fonttype": "path"}):
        look = {"squeeze": False, "layout": "constrained", "sharey": True, "facecolor": "white"}
        figure, axes = plt.subplots(lines, columns, figsize=size, **look)  # type: ignore[call-overload]
        for axis, name in zip(axes.flat, names, strict=False):
            _panel(axis, name, summary)
        for axis in list(axes.flat)[len(names) :]:
            axis.set_visible(False)
        _scale(axes[0, 0], summary)
        _legend(figure, summary)
        write_picture(figure, path)


def _panel(axis: Axes, name: str, summary: Summary) -> None:
    rows = [row for row in summary.of_bags(name) if row["status"] == DONE and row["selection_J"] is not None]
    best = front(rows)
    on_front = {row["key"] for row in best}
    x, y = [row["parameters"] for row in best], [row["selection_J"] for row in best]
    axis.plot(x, y, drawstyle="steps-post", color=INK, lw=1.1, zorder=2)
    for row in rows:
        _mark(axis, row, row["key"] in on_front)
    for row in best:
        _validation(axis, row, summary)
    _recommend(axis, name, recommend_model(rows))
    only_polynomials = all(row["structure"] == POLYNOMIAL.option for row in summary.rows)
    axis.set_xlabel("terms" if only_polynomials else "parameters (for a polynomial: terms)", fontsize=9)
    axis.set_ylabel("cost J [%]", fontsize=9)
    _axis_scale(axis, "x", [row["parameters"] for row in rows])
    style_axis(axis)
    axis.tick_params(labelleft=True)


def _mark(axis: Axes, row: Row, on_front: bool) -> None:
    color, marker = LOOK[row["structure"]]
    face = color if is_proved(row) else "white"
    size, alpha, order = (7.0, 1.0, 4) if on_front else (5.5, 0.4, 3)
    look: dict[str, Any] = {"ms": size, "color": color, "markerfacecolor": face, "alpha": alpha, "zorder": order}
    axis.plot(row["parameters"], row["selection_J"], marker, **look)


def _validation(axis: Axes, row: Row, summary: Summary) -> None:
    """Draw the mean validation cost of a model on the front, with a line to its selection cost."""
    costs = [cost for name in summary.sets if (cost := mean_cost(row, name)) is not None]
    if costs:
        mean = sum(costs) / len(costs)
        axis.plot([row["parameters"]] * 2, [row["selection_J"], mean], color=PALE, lw=0.8, ls=(0, (2, 2)), zorder=1)
        axis.plot(row["parameters"], mean, "_", ms=10, mew=1.8, color=PALE, zorder=2)


def _recommend(axis: Axes, name: str, chosen: Row | None) -> None:
    """Mark the recommended model with a ring and name it in the title."""
    text = ""
    if chosen is not None:
        axis.plot(chosen["parameters"], chosen["selection_J"], "o", ms=14, mew=1.3, color=INK, mfc="none", zorder=5)
        text = f"\nrecommended: {chosen['size']}, J = {chosen['selection_J']:.2f} %"
    axis.set_title(f"identified on {name}{text}", loc="left", fontsize=9.5)


def _scale(axis: Axes, summary: Summary) -> None:
    """Set the cost scale shared by all panels: from 0, or logarithmic with a margin below."""
    rows = [row for row in summary.rows if row["status"] == DONE and row["selection_J"] is not None]
    shown = [cost for row in rows for name in summary.sets if (cost := mean_cost(row, name)) is not None]
    _axis_scale(axis, "y", [row["selection_J"] for row in rows] + shown)
    low, high = axis.get_ylim()
    axis.set_ylim(low / (high / low) ** 0.12 if axis.get_yscale() == "log" else 0.0, high)


def _axis_scale(axis: Axes, which: str, values: list[float]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    scaled = getattr(axis, f"{which}axis")
    if values and min(values) > 0.0 and max(values) > LOG_RATIO * min(values):
        axis.set(**{f"{which}scale": "log"})
        scaled.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        scaled.set_minor_formatter(NullFormatter())
    else:
        scaled.set_major_locator(MaxNLocator(integer=which == "x", nbins=8))
    scaled.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _legend(figure: Figure, summary: Summary) -> None:
    from matplotlib.lines import Line2D

    done = [row for row in summary.rows if row["status"] == DONE]
    handles = [
        Line2D([], [], color=color, marker=marker, ls="none", label=structure)
        for structure, (color, marker) in LOOK.items()
        if any(row["structure"] == structure for row in done)
    ]
    if not all(is_proved(row) for row in done):
        label = "stability not proved"
        handles.append(Line2D([], [], color=INK, marker="o", markerfacecolor="white", ls="none", label=label))
    handles.append(Line2D([], [], color=INK, lw=1.1, label="front, by selection cost"))
    handles.append(Line2D([], [], color=INK, marker="o", ms=11, markerfacecolor="none", ls="none", label="recommended"))
    if summary.sets:
        label = "validation cost (mean), not used for selection"
        handles.append(Line2D([], [], color=PALE, marker="_", ms=10, mew=1.8, ls="none", label=label))
    columns = 3 if len(handles) > 4 else 5
    figure.legend(handles=handles, loc="outside upper left", ncols=columns, frameon=False, fontsize=8.5)
