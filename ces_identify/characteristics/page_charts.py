"""What the charts show in which colour: levels of current, sources, and the test points whose loops are shown."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TypeVar

import numpy as np

from ces_data.arrays import F
from ces_identify.characteristics.cycles import DIRECTIONS
from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.rows import Characteristics, ConditionRow, LoopPoint, PeakForce, SpeedBin
from ces_identify.characteristics.steps import MIN_STEPS
from ces_report.drawing import span_of
from ces_report.figure import CURVES, PlotMark
from ces_report.plot import Plot, PlotArea, PlotBand, PlotDots, PlotLine, curve_css, series_css

MAX_TEST_POINTS = 3  # amplitudes and frequencies whose loops are shown
SAME_TEST = 0.06  # relative difference of amplitude and frequency within a test point
MANY_SOURCES = 3
BAND_POINTS = 400  # a band is drawn in columns, which should touch each other
SPEED, FORCE = "Speed [m/s]", "Force [N]"
SPREAD = "bounds measured"  # the style of a band of measured forces


@dataclass(frozen=True)
class Palette:
    """The classes of a line by source and current."""

    sources: tuple[str, ...]
    currents: tuple[float, ...]

    def css(self, source: str, current: float) -> str:
        """Return the classes of a line."""
        number = self.sources.index(source)
        if len(self.sources) >= MANY_SOURCES:
            return "measured" if source == MEASURED else series_css(number)
        curve = _shade(int(np.argmin(np.abs(np.array(self.currents) - current))), len(self.currents))
        return curve if source == MEASURED else f"{curve} beyond"

    def name(self, source: str, current: float) -> str:
        """Return the entry of the legend."""
        if len(self.sources) >= MANY_SOURCES:
            return source
        return f"{current:.3g} A" + ("" if source == MEASURED else f", {source}")


@dataclass(frozen=True)
class TestPoint:
    """An amplitude [m] and a frequency [Hz] that were run at one or several currents."""

    amplitude_m: float
    frequency_Hz: float

    @property
    def speed_m_s(self) -> float:
        """The peak speed of a sine [m/s]."""
        return 2.0 * np.pi * self.amplitude_m * self.frequency_Hz

    def holds(self, row: ConditionRow) -> bool:
        """Return whether a row belongs to this point."""
        close = abs(np.log(row.amplitude_m / self.amplitude_m)) <= SAME_TEST
        return bool(close and abs(np.log(row.frequency_Hz / self.frequency_Hz)) <= SAME_TEST)


def make_palette(results: Characteristics) -> Palette:
    """Return the palette of all levels of current."""
    return Palette(results.sources, tuple(sorted({row.current_A for row in results.peak_velocity})))


def choose_test_points(results: Characteristics) -> list[TestPoint]:
    """Return the points whose loops are shown: slowest, middle and fastest of those run at the most currents."""
    points: dict[TestPoint, set[float]] = {}
    for row in results.work:
        point = next((p for p in points if p.holds(row)), as_test_point(row))
        points.setdefault(point, set()).add(row.current_A)
    most = max((len(currents) for currents in points.values()), default=0)
    full = sorted((p for p, currents in points.items() if len(currents) == most), key=attrgetter("speed_m_s"))
    chosen = np.unique(np.rint(np.linspace(0, len(full) - 1, min(MAX_TEST_POINTS, len(full)))).astype(int))
    return [full[k] for k in chosen]


def as_test_point(row: ConditionRow) -> TestPoint:
    """Return the test point of a row."""
    return TestPoint(row.amplitude_m, row.frequency_Hz)


def _shade(number: int, count: int) -> str:
    """Return the classes of a curve; more than CURVES curves take shades halfway between two colours, too."""
    if count <= CURVES:
        return curve_css(number, count)
    step = round(number * 2 * (CURVES - 1) / (count - 1))
    return f"curve c{step // 2}{' half' if step % 2 else ''}"


Row = TypeVar("Row")


def peak_chart(results: Characteristics, palette: Palette) -> Plot:
    """Return the peak velocity pick-up: one curve for each current and source."""
    curves = _curves(results, results.peak_velocity)
    marks = [mark for source, current, rows in curves for mark in _peak_marks(palette, source, current, rows)]
    return Plot(
        ident="peak-velocity",
        title="Force at the peak speed of each cycle",
        text="Mean force at the peak speed of compression (right) and rebound (left), a curve for each current.",
        x_label=f"Peak {SPEED[0].lower()}{SPEED[1:]}",
        areas=[PlotArea(FORCE, marks, height=330, y_ticks=8)],
        width=900.0,
        free=True,
    )


def loop_charts(results: Characteristics, palette: Palette, number: int, point: TestPoint) -> tuple[Plot, Plot]:
    """Return force over stroke and force over speed of the mean cycle at one test point."""
    what = f"{1e3 * point.amplitude_m:.3g} mm, {point.frequency_Hz:.3g} Hz"
    loops = [(source, current, rows) for source, current, rows in _loops(results) if point.holds(rows[0])]

    def plot(kind: str, title: str, x_label: str, x: Callable[[LoopPoint], float], scale: float) -> Plot:
        marks = [
            PlotLine(
                palette.name(source, current),
                scale * _values(rows, x),
                _values(rows, attrgetter("force_N")),
                palette.css(source, current),
            )
            for source, current, rows in loops
        ]
        text = f"{title} of the mean cycle of {what}, a loop for each current."
        areas = [PlotArea(FORCE, marks, height=280, y_ticks=7)]
        return Plot(f"{kind}-{number}", f"{title}, {what}", text, x_label, areas, width=550.0, free=True)

    stroke = plot("stroke", "Force over stroke", "Position [mm]", attrgetter("position_m"), 1e3)
    return stroke, plot("speed", "Force over speed", SPEED, attrgetter("speed_m_s"), 1.0)


def work_chart(results: Characteristics, palette: Palette) -> Plot:
    """Return the work per cycle over the peak speed of a sine of the same amplitude and frequency."""
    marks: list[PlotMark] = []
    for source, current, rows in _curves(results, results.work):
        name, css = palette.name(source, current), palette.css(source, current)
        for stroke in _group_strokes(rows):
            x, y = (_values(stroke, get) for get in (lambda r: as_test_point(r).speed_m_s, attrgetter("work_J")))
            marks.append(PlotLine(name, x, y, css))
            marks.append(PlotDots(name, x, y, f"{css} {'spot' if source == MEASURED else 'dots'}"))
    text = "Energy dissipated in a cycle over 2π times amplitude times frequency; lines connect equal amplitudes."
    areas = [PlotArea("Work per cycle [J]", marks, height=230)]
    return Plot("work-chart", "Work per cycle", text, "2π · amplitude · frequency [m/s]", areas, width=900.0, free=True)


def response_chart(results: Characteristics, direction: str, palette: Palette) -> Plot | None:
    """Return the mean normalised response to steps in one direction of motion; None if there are none."""
    marks: list[PlotMark] = []
    rows = [row for row in results.response_points if row.direction == direction and row.steps >= MIN_STEPS]
    for n, key in enumerate(dict.fromkeys((round(r.from_A, 6), round(r.to_A, 6), r.source) for r in rows)):
        points = [r for r in rows if (round(r.from_A, 6), round(r.to_A, 6), r.source) == key]
        t, y, spread = (_values(points, attrgetter(name)) for name in ("time_s", "share", "share_sd"))
        if key[2] == MEASURED:
            marks.insert(0, PlotBand("± standard deviation, measured", 1e3 * t, y - spread, y + spread, SPREAD))
        marks.append(PlotLine(f"{key[0]:.2g} to {key[1]:.2g} A, {key[2]}", 1e3 * t, y, series_css(n)))
    if not marks:
        return None
    text = f"Mean change of force after a step of the current in {direction}; band: standard deviation between steps."
    title = f"Response to steps of the current, {direction}"
    area = PlotArea("Share of the change of force", marks, height=230)
    return Plot(f"response-{direction}", title, text, "Time since the step [ms]", [area], width=550.0)


def motion_charts(results: Characteristics) -> Iterator[Plot]:
    """Yield for each group of currents the quantiles of the force over speed, over any motion."""
    rows = results.speed_bins
    for n, group in enumerate(dict.fromkeys((r.current_from_A, r.current_to_A) for r in rows)):
        marks: list[PlotMark] = []
        for k, source in enumerate(results.sources):
            bins = [r for r in rows if r.source == source and (r.current_from_A, r.current_to_A) == group]
            marks += list(_bin_marks(bins, source, "measured" if source == MEASURED else series_css(k)))
        currents = f"{group[0]:.3g} to {group[1]:.3g} A" if group[1] > group[0] else f"{group[0]:.3g} A"
        text = f"Median of the force over speed at {currents}; band: from the 10 % to the 90 % quantile, measured."
        title = f"Any motion, {currents}"
        forces = [f for row in rows if (row.current_from_A, row.current_to_A) == group for f in (row.low_N, row.high_N)]
        area = PlotArea(FORCE, marks, height=210, y_range=span_of(np.array(forces)))
        yield Plot(f"motion-{n}", title, text, SPEED, [area], width=550.0, free=True)


def _curves(results: Characteristics, rows: Sequence[ConditionRow]) -> Iterator[tuple[str, float, list[ConditionRow]]]:
    """Yield the rows of each source and level of current; simulations last, on top."""
    for source in results.sources:
        for current in sorted({row.current_A for row in rows}):
            own = [row for row in rows if row.source == source and row.current_A == current]
            if own:
                yield source, current, own


def _loops(results: Characteristics) -> Iterator[tuple[str, float, list[LoopPoint]]]:
    """Yield the points of each loop."""
    loops: dict[tuple[str, float, float, float], list[LoopPoint]] = {}
    for row in results.loops:
        loops.setdefault((row.source, row.current_A, row.amplitude_m, row.frequency_Hz), []).append(row)
    for (source, current, _, _), rows in sorted(loops.items(), key=lambda item: results.sources.index(item[0][0])):
        yield source, current, rows


def _peak_marks(palette: Palette, source: str, current: float, rows: Sequence[ConditionRow]) -> Iterator[PlotMark]:
    peaks = [row for row in rows if isinstance(row, PeakForce)]
    name, css = palette.name(source, current), palette.css(source, current)
    for direction in DIRECTIONS:
        side = sorted((r for r in peaks if r.direction == direction), key=lambda r: abs(r.speed_m_s))
        x, y = (_values(side, attrgetter(column)) for column in ("speed_m_s", "force_N"))
        yield PlotLine(name, x, y, css)
        if source == MEASURED:
            yield PlotDots(name, x, y, f"{css} spot")


def _bin_marks(bins: Sequence[SpeedBin], source: str, css: str) -> Iterator[PlotMark]:
    x = _values(bins, lambda b: 0.5 * (b.speed_from_m_s + b.speed_to_m_s))
    low, middle, high = (_values(bins, attrgetter(name)) for name in ("low_N", "median_N", "high_N"))
    if source == MEASURED:
        dense = np.linspace(x[0], x[-1], BAND_POINTS) if len(x) else x
        yield PlotBand(f"10 to 90 %, {source}", dense, np.interp(dense, x, low), np.interp(dense, x, high), SPREAD)
    yield PlotLine(source, x, middle, css)


def _values(rows: Sequence[Row], get: Callable[[Row], float]) -> F:
    return np.array([get(row) for row in rows], np.float64)


def _group_strokes(rows: Sequence[ConditionRow]) -> list[list[ConditionRow]]:
    """Return the rows in groups of nearly the same amplitude, each in the order of speed."""
    groups: list[list[ConditionRow]] = []
    for row in sorted(rows, key=attrgetter("amplitude_m")):
        if groups and row.amplitude_m <= (1.0 + SAME_TEST) * groups[-1][0].amplitude_m:
            groups[-1].append(row)
        else:
            groups.append([row])
    return [sorted(group, key=lambda row: as_test_point(row).speed_m_s) for group in groups]
