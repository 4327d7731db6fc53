"""The charts of the characteristics: measured beside simulated, coloured by current or by source."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from ces_data.arrays import F
from ces_identify.characteristics.conditions import group_curves, is_same_test
from ces_identify.characteristics.cycles import DIRECTIONS
from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.rows import (
    Characteristics,
    ConditionRow,
    CurrentForce,
    CycleWork,
    LoopPoint,
    ResponsePoint,
)
from ces_identify.limits import DynoLimits
from ces_report.drawing import span_of
from ces_report.figure import CURVES, PlotMark
from ces_report.plot import (
    Plot,
    PlotArea,
    PlotBand,
    PlotDots,
    PlotLine,
    PlotScale,
    curve_css,
    series_css,
)

MAX_TEST_POINTS = 3  # amplitudes and frequencies whose loops are shown
MANY_SOURCES = 3
BAND_POINTS = 400  # a band is drawn in columns, which should touch each other
SPEED, FORCE, CURRENT = "Speed [m/s]", "Force [N]", "Current [A]"
SPREAD = "bounds measured"  # the style of a band of measured forces


@dataclass(frozen=True)
class Palette:
    """Name and colour of a line by source and level: a current, or a speed."""

    sources: tuple[str, ...]
    levels: tuple[float, ...]
    what: str = "Current"
    unit: str = "A"

    def style(self, source: str, level: float) -> tuple[str, str]:
        """Return the entry of the legend and the classes of a line; more than CURVES curves take half shades, too."""
        if len(self.sources) >= MANY_SOURCES:
            return source, "measured" if source == MEASURED else series_css(self.sources.index(source))
        number, count = int(np.argmin(np.abs(np.array(self.levels) - level))), len(self.levels)
        curve = curve_css(number, count)
        if count > CURVES:
            step = round(number * 2 * (CURVES - 1) / (count - 1))
            curve = f"curve c{step // 2}{' half' if step % 2 else ''}"
        name = f"{level:.3g} {self.unit}"
        return (name, curve) if source == MEASURED else (f"{name}, {source}", f"{curve} beyond")

    @property
    def scale(self) -> PlotScale | None:
        """The colours from the lowest to the highest level; None where colours show sources."""
        if len(self.sources) >= MANY_SOURCES or not self.levels:
            return None
        styles = [self.style(MEASURED, level)[1] for level in self.levels]
        low, high = f"{self.what} {self.levels[0]:.3g}", f"{self.levels[-1]:.3g} {self.unit}"
        return PlotScale(list(dict.fromkeys(styles)), low, high)


def choose_test_points(results: Characteristics) -> list[CycleWork]:
    """Return a row of each point whose loops are shown: slowest, middle, fastest of those run at the most currents."""
    points: list[tuple[CycleWork, set[float]]] = []
    for row in results.work:
        currents = next((currents for point, currents in points if is_same_test(point, row)), None)
        if currents is None:
            points.append((row, currents := set()))
        currents.add(row.current_A)
    most = max((len(currents) for _, currents in points), default=0)
    full = sorted((point for point, currents in points if len(currents) == most), key=_sine_speed)
    chosen = np.unique(np.rint(np.linspace(0, len(full) - 1, min(MAX_TEST_POINTS, len(full)))).astype(int))
    return [full[k] for k in chosen]


def _sine_speed(row: ConditionRow) -> float:
    """Return the peak speed [m/s] of a sine."""
    return 2.0 * np.pi * row.amplitude_m * row.frequency_Hz


def family_chart(results: Characteristics) -> Plot:
    """Return the force over speed at each current: points measured in any motion, and a curve for each simulation."""
    groups = dict.fromkeys((row.current_from_A, row.current_to_A) for row in results.speed_bins)
    palette = Palette(results.sources, tuple(0.5 * (low + high) for low, high in groups))
    marks: list[PlotMark] = []
    for source in results.sources:
        for current, group in zip(palette.levels, groups, strict=True):
            bins = [r for r in results.speed_bins if r.source == source and (r.current_from_A, r.current_to_A) == group]
            x = 0.5 * (_values(bins, "speed_from_m_s") + _values(bins, "speed_to_m_s"))
            (name, css), y = palette.style(source, current), _values(bins, "median_N")
            if source == MEASURED:
                marks.append(PlotDots(name, x, y, f"{css} spot", source))
            if source != MEASURED or len(results.sources) == 1:
                marks.append(PlotLine(name, x, y, css.replace(" beyond", ""), group=source))
    title, areas = "Force over speed at each current", [PlotArea(FORCE, marks, height=360, y_ticks=8)]
    text = "Medians of the force in bins of speed: measured (dots), and of each simulation there (lines)."
    return Plot("family", title, text, SPEED, areas, width=900.0, free=True, scale=palette.scale)


def peak_chart(results: Characteristics, palette: Palette) -> Plot:
    """Return the peak velocity pick-up: one curve for each current and source."""
    marks: list[PlotMark] = []
    for source, current, rows in _curves(results, results.peak_velocity):
        name, css = palette.style(source, current)
        for direction in DIRECTIONS:
            side = sorted((r for r in rows if r.direction == direction), key=lambda r: abs(r.speed_m_s))
            x, y = _values(side, "speed_m_s"), _values(side, "force_N")
            marks.append(PlotLine(name, x, y, css, group=source))
            if source == MEASURED:
                marks.append(PlotDots(name, x, y, f"{css} spot", source))
    title, areas = "Force over speed at each test point", [PlotArea(FORCE, marks, height=330, y_ticks=8)]
    text = "Force by the rules in compression (right) and rebound (left), a curve for each current."
    return Plot("peak-velocity", title, text, SPEED, areas, width=900.0, free=True, scale=palette.scale)


def loop_charts(results: Characteristics, palette: Palette, number: int, point: ConditionRow) -> tuple[Plot, Plot]:
    """Return force over stroke and force over speed of the mean cycle at one test point."""
    what = f"{1e3 * point.amplitude_m:.3g} mm, {point.frequency_Hz:.3g} Hz"
    loops: dict[tuple[int, float, float, float], list[LoopPoint]] = {}
    for row in results.loops:
        key = results.sources.index(row.source), row.current_A, row.amplitude_m, row.frequency_Hz
        loops.setdefault(key, []).append(row)
    shown = [rows for _, rows in sorted(loops.items(), key=lambda item: item[0][0]) if is_same_test(point, rows[0])]

    def plot(kind: str, title: str, x_label: str, x: str, scale: float) -> Plot:
        marks = []
        for rows in shown:
            name, css = palette.style(rows[0].source, rows[0].current_A)
            marks.append(PlotLine(name, scale * _values(rows, x), _values(rows, "force_N"), css, group=rows[0].source))
        text = f"{title} of the mean cycle of {what}, a loop for each current."
        areas = [PlotArea(FORCE, marks, height=280, y_ticks=7)]
        ident = f"{kind}-{number}"
        return Plot(ident, f"{title}, {what}", text, x_label, areas, width=550.0, free=True, scale=palette.scale)

    stroke = plot("stroke", "Force over stroke", "Position [mm]", "position_m", 1e3)
    return stroke, plot("speed", "Force over speed", SPEED, "speed_m_s", 1.0)


def work_chart(results: Characteristics, palette: Palette) -> Plot:
    """Return the work per cycle over the peak speed of a sine; lines connect nearly equal amplitudes."""
    marks: list[PlotMark] = []
    for source, current, rows in _curves(results, results.work):
        name, css = palette.style(source, current)
        strokes: list[list[CycleWork]] = []
        for row in sorted(rows, key=attrgetter("amplitude_m")):
            if strokes and row.amplitude_m <= (1.0 + 2.0 * DynoLimits.SAME) * strokes[-1][0].amplitude_m:
                strokes[-1].append(row)
            else:
                strokes.append([row])
        for stroke in (sorted(rows, key=_sine_speed) for rows in strokes):
            x, y = np.array([_sine_speed(row) for row in stroke]), _values(stroke, "work_J")
            marks.append(PlotLine(name, x, y, css, group=source))
            marks.append(PlotDots(name, x, y, f"{css} {'spot' if source == MEASURED else 'dots'}", source))
    text = "Energy dissipated in a cycle over 2π times amplitude times frequency; lines connect equal amplitudes."
    areas = [PlotArea("Work per cycle [J]", marks, height=230)]
    x_label = "2π · amplitude · frequency [m/s]"
    return Plot("work-chart", "Work per cycle", text, x_label, areas, width=900.0, free=True, scale=palette.scale)


def current_chart(results: Characteristics) -> Plot:
    """Return the force over current at each speed; where currents were raised and lowered, both branches as a loop."""
    curves = group_curves(results.over_current)
    speeds = tuple(sorted({_nominal_speed(curve) for curve in curves.values()}))
    palette = Palette(results.sources, speeds, "Speed", "m/s")
    marks: list[PlotMark] = []
    for (source, *_), curve in sorted(curves.items(), key=lambda item: results.sources.index(item[0][0])):
        name, css = palette.style(source, _nominal_speed(curve))
        current, force = _values(curve, "current_A"), _values(curve, "force_N")
        for branch in ("raised_N", "lowered_N"):
            one = _values(curve, branch)
            marks.append(PlotLine(name, current, np.where(np.isfinite(one), one, force), css, group=source))
        if source == MEASURED:
            marks.append(PlotDots(name, current, force, f"{css} spot", source))
    text = "Force over current, a curve for each speed, compression above and rebound below zero."
    areas = [PlotArea(FORCE, marks, height=330, y_ticks=8)]
    title = "Force over current at each speed"
    return Plot("over-current", title, text, CURRENT, areas, width=900.0, free=True, scale=palette.scale)


def range_chart(results: Characteristics) -> Plot:
    """Return range and ratio of hard and soft over speed, by direction and source."""
    areas = []
    for label, name in (("Range hard \N{MINUS SIGN} soft [N]", "range_N"), ("Ratio hard / soft", "ratio")):
        marks: list[PlotMark] = []
        for n, (direction, source) in enumerate((d, s) for s in results.sources for d in DIRECTIONS):
            rows = [row for row in results.ranges if (row.direction, row.source) == (direction, source)]
            rows.sort(key=lambda row: abs(row.speed_m_s))
            x, y, title = np.abs(_values(rows, "speed_m_s")), _values(rows, name), f"{direction}, {source}"
            marks += [PlotLine(title, x, y, series_css(n)), PlotDots(title, x, y, f"{series_css(n)} spot")]
        reach = max((getattr(row, name) for row in results.ranges if np.isfinite(getattr(row, name))), default=1.0)
        areas.append(PlotArea(label, marks, height=170, y_range=(min(0.0, reach), 1.1 * abs(reach))))
    text = "Difference and ratio of the forces at the hardest and the softest current over speed."
    return Plot("range", "Range and ratio over speed", text, SPEED, areas, width=900.0)


def _nominal_speed(curve: Sequence[CurrentForce]) -> float:
    """Return the target speed of a curve, else that of a sine [m/s]."""
    target = curve[0].target_m_s
    return target if np.isfinite(target) else float(f"{_sine_speed(curve[0]):.3g}")


def response_charts(results: Characteristics) -> Iterator[Plot]:
    """Yield the mean normalised response to steps in each direction of motion with steps."""
    for direction in DIRECTIONS:
        marks: list[PlotMark] = []
        enough = [row for row in results.response_points if row.steps >= DynoLimits.MIN_REPEATS]
        rows = [row for row in enough if row.direction == direction]
        for n, key in enumerate(dict.fromkeys(_kind_of(row) for row in rows)):
            points = [row for row in rows if _kind_of(row) == key]
            t, y, spread = (_values(points, name) for name in ("time_s", "share", "share_sd"))
            if key[3] == MEASURED:
                marks.insert(0, PlotBand("± standard deviation, measured", 1e3 * t, y - spread, y + spread, SPREAD))
            name = f"{key[0]:.2g} to {key[1]:.2g} A at {key[2]:.2g} m/s, {key[3]}"
            marks.append(PlotLine(name, 1e3 * t, y, series_css(n)))
        if marks:
            text = f"Mean change of force after a step of the current in {direction}; band: standard deviation"
            title = f"Response to steps of the current, {direction}"
            areas = [PlotArea("Share of the change of force", marks, height=230)]
            x_label, width = "Time since the step [ms]", 550.0
            yield Plot(f"response-{direction}", title, f"{text} between steps.", x_label, areas, width)


def _kind_of(row: ResponsePoint) -> tuple[float, float, float, str]:
    return round(row.from_A, 6), round(row.to_A, 6), round(abs(row.speed_m_s), 3), row.source


def motion_charts(results: Characteristics) -> Iterator[Plot]:
    """Yield for each group of currents the quantiles of the force over speed, over any motion."""
    for n, group in enumerate(dict.fromkeys((r.current_from_A, r.current_to_A) for r in results.speed_bins)):
        rows = [r for r in results.speed_bins if (r.current_from_A, r.current_to_A) == group]
        marks: list[PlotMark] = []
        for k, source in enumerate(results.sources):
            bins = [r for r in rows if r.source == source]
            x = np.array([0.5 * (b.speed_from_m_s + b.speed_to_m_s) for b in bins])
            low, middle, high = (_values(bins, name) for name in ("low_N", "median_N", "high_N"))
            if source == MEASURED:
                dense = np.linspace(x[0], x[-1], BAND_POINTS) if len(x) else x
                ends = np.interp(dense, x, low), np.interp(dense, x, high)
                marks.append(PlotBand(f"10 to 90 %, {source}", dense, *ends, SPREAD))
            marks.append(PlotLine(source, x, middle, "measured" if source == MEASURED else series_css(k)))
        currents = f"{group[0]:.3g} to {group[1]:.3g} A" if group[1] > group[0] else f"{group[0]:.3g} A"
        text = f"Median of the force over speed at {currents}; band: from the 10 % to the 90 % quantile, measured."
        y_range = span_of(_values(rows, "low_N"), _values(rows, "high_N"))
        area = PlotArea(FORCE, marks, height=210, y_range=y_range)
        yield Plot(f"motion-{n}", f"Any motion, {currents}", text, SPEED, [area], width=550.0, free=True)


def _curves(results: Characteristics, rows: Sequence[Any]) -> Iterator[tuple[str, float, list[Any]]]:
    """Yield the rows of each source and level of current; simulations last, on top."""
    for source in results.sources:
        for current in sorted({row.current_A for row in rows}):
            own = [row for row in rows if row.source == source and row.current_A == current]
            if own:
                yield source, current, own


def _values(rows: Sequence[Any], name: str) -> F:
    return np.array([getattr(row, name) for row in rows], np.float64)
