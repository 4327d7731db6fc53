"""The charts of the pages, drawn as in the reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_identify.campaign.front import front, recommend_model
from ces_identify.jobs.row_log import Row
from ces_identify.numerics.arrays import F
from ces_identify.report.plot import Plot, PlotArea, PlotBand, PlotDots, PlotLine, draw_plot, series_css

WIDTH, NARROW_WIDTH = 760.0, 420.0  # the latter for a phone
LIVE_S = 10.0  # [s] that the view of a running observer shows
MAX_OVER_BEST = 5.0  # of a search: the first costs, which are far higher, would leave the rest a flat line
NO_LINE: F = np.array([-LIVE_S, 0.0])
NOTHING: F = np.full(2, np.nan)
UNITS = {"position": "Position [m]", "current": "Current [A]", "force": "Force [N]"}


def campaign_chart(number: int, bags: str, rows: Sequence[Row]) -> Markup | None:
    """Return selection cost against parameters, with the front; None unless models of two sizes have a cost."""
    rows = [row for row in rows if row["selection_J"] is not None]
    if len({row["parameters"] for row in rows}) < 2:
        return None
    structures = list(dict.fromkeys(str(row["structure"]) for row in rows))
    best = front(rows)
    marks: list[PlotLine | PlotDots] = [PlotLine("front", *_steps(best), "outline")]
    for k, structure in enumerate(structures):
        own = [row for row in rows if str(row["structure"]) == structure]
        marks.append(PlotDots(structure, *_points(own), f"{series_css(k)} spot"))
    chosen = recommend_model(rows)
    text = f"Selection cost of {len(rows)} models identified on {bags} against their number of parameters."
    if chosen is not None:
        text += f" Recommended: {chosen['size']}, J = {chosen['selection_J']:.2f} %."
    label = "Parameters (for a polynomial: terms)"
    area = PlotArea("Selection cost J [%]", marks, height=220.0)
    plot = Plot(f"front{number}", f"Cost against size, {bags}", text, label, [area], WIDTH, free=True)
    return draw_plot(plot)


def iteration_chart(rows: Sequence[Mapping[str, Any]]) -> list[Markup]:
    """Return the costs against the recorded seconds, from two iterations on."""
    if len(rows) < 2:
        return []
    time_s = _array(row["total_s"] for row in rows)
    lines = (("before it was used", "fresh_J", 0), ("after the fit", "fit_J", 1))
    marks: list[PlotLine | PlotDots] = []
    for name, key, k in lines:
        cost = _array(row[key] for row in rows)
        marks += [PlotLine(name, time_s, cost, series_css(k)), PlotDots(name, time_s, cost, f"{series_css(k)} spot")]
    text = "Cost of the models on each new recording before it was used, and on all recordings after the fit."
    area, view = PlotArea("Cost J [%]", marks), (0.0, 1.03 * float(time_s.max()))
    return [draw_plot(Plot("iterations", "Cost against recorded time", text, "Recorded [s]", [area], WIDTH, view))]


def stroke_chart(runs: Sequence[Mapping[str, Any]], repeatability_m: float) -> list[Markup]:
    """Return the error of each run."""
    number, error = np.arange(1.0, len(runs) + 1.0), _array(1e3 * run["error_m"] for run in runs)
    marks: list[PlotLine | PlotDots] = [
        PlotLine("error", number, error, series_css(0)),
        PlotDots("error", number, error, f"{series_css(0)} spot"),
        PlotLine("repeatability", number, np.full(len(runs), 1e3 * repeatability_m), "error"),
    ]
    text = "RMS error of the stroke in each run, and the repeatability."
    area, view = PlotArea("Error [mm RMS]", marks), (0.7, len(runs) + 0.3)
    plot = Plot("runs", "Error of each run", text, "Run", [area], WIDTH, view, x_ticks=min(len(runs), 12))
    return [draw_plot(plot)] if len(runs) > 1 else []


def recording_chart(channels: Sequence[Mapping[str, Any]]) -> list[Markup]:
    """Return the signals against time, one area below the other."""
    shown = [channel for channel in channels if len(channel["value"]) > 1]
    areas = [
        PlotArea(
            UNITS.get(channel["name"], f"{channel['name']} [{channel['unit']}]"),
            [PlotLine(channel["name"], _array(channel["time_s"]), _array(channel["value"]), series_css(k))],
            height=110.0,
        )
        for k, channel in enumerate(shown)
    ]
    text = "The signals as logged; of long recordings the lowest and highest value of each of 600 parts."
    return (
        [draw_plot(Plot("signals", "Signals over time", text, "Time [s]", areas, WIDTH, legend=False))] if areas else []
    )


def search_chart(rows: Sequence[Mapping[str, Any]], title: str) -> list[Markup]:
    """Return the costs of the starts against the time, and the best so far; nothing before the first model."""
    found = [row for row in rows if isinstance(row.get("cost"), int | float)]
    if not found:
        return []
    limit = MAX_OVER_BEST * min(row["cost"] for row in found)
    shown = [row for row in found if row["cost"] <= limit]
    time_s, cost = _array(row["elapsed_s"] for row in shown), _array(row["cost"] for row in shown)
    best = np.minimum.accumulate(cost)
    steps = np.repeat(time_s, 2)[1:], np.repeat(best, 2)[:-1]
    ended = np.array([row.get("ended") != "running" for row in shown])
    marks: list[PlotLine | PlotDots] = [
        PlotLine("best so far", *steps, series_css(0)),
        PlotDots("improvement", time_s[~ended], cost[~ended], f"{series_css(0)} spot"),
        PlotDots("end of a start", time_s[ended], cost[ended], f"{series_css(1)} spot"),
    ]
    text = f"Selection cost of the best model so far: {best[-1]:.2f} % after {time_s[-1]:.1f} s."
    label = "Selection cost J [%]" + (f", up to {MAX_OVER_BEST:g} times the best" if len(shown) < len(found) else "")
    area = PlotArea(label, marks, height=240.0)
    plot = Plot("search", title, text, "Time [s]", [area], WIDTH, x_view=(0.0, 1.03 * float(time_s[-1])))
    return [draw_plot(plot)]


def observer_chart(ident: str, name: str, narrow: bool) -> Markup:
    """Return the chart of a running observer without values, which the page fills while they come."""
    width = NARROW_WIDTH if narrow else WIDTH
    band = PlotBand("band, 90 %", NO_LINE, NOTHING, NOTHING, "bounds")
    areas = [
        PlotArea("Force [N]", [band, PlotLine("estimate", NO_LINE, NOTHING, "simulated")], 240.0, (-1.0, 1.0)),
        PlotArea("Speed [m/s]", [PlotLine("speed", NO_LINE, NOTHING, series_css(0))], 80.0, (-1.0, 1.0)),
        PlotArea("Position [mm]", [PlotLine("position", NO_LINE, NOTHING, series_css(2))], 80.0, (-1.0, 1.0)),
    ]
    text = f"Estimated force with its band, speed and position of {name} in the last {LIVE_S:.0f} s."
    return draw_plot(Plot(ident, f"Observer {name}", text, "Time [s]", areas, width, x_view=(-LIVE_S, 0.0)))


def _points(rows: Sequence[Mapping[str, Any]]) -> tuple[F, F]:
    return _array(row["parameters"] for row in rows), _array(row["selection_J"] for row in rows)


def _steps(best: Sequence[Mapping[str, Any]]) -> tuple[F, F]:
    x, y = _points(best)
    return np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]


def _array(values: Any) -> F:
    """Return numbers as an array, NaN for None."""
    return np.array([np.nan if value is None else value for value in values], np.float64)
