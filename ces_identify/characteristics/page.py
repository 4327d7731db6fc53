"""The results as files: the page with charts and tables, measured beside simulated, and a CSV file for each table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F
from ces_identify.characteristics.cycles import DIRECTIONS, SHARES
from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.rows import (
    TABLES,
    Characteristics,
    ConditionRow,
    ContinuousForce,
    CycleWork,
    LoopPoint,
    Omission,
    PeakForce,
    RecordingFacts,
    ValveResponse,
)
from ces_identify.limits import DynoLimits
from ces_observer.json_text import write_atomically
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
    draw_plot,
    series_css,
    share_points,
)
from ces_report.shell import PageHead, page_template, replace_unencodable
from ces_report.table import Column, Table, as_csv, columns_of, row_fields, rows_as_csv, summarize_result
from ces_report.typesetting import format_decimal, join_names

PAGE, COLUMNS = "characteristics.html", "columns.csv"
MAX_TEST_POINTS = 3  # amplitudes and frequencies whose loops are shown
SAME_TEST = 0.06  # relative difference of amplitude and frequency within a test point
MANY_SOURCES = 3
BAND_POINTS = 400  # a band is drawn in columns, which should touch each other
SPEED, FORCE = "Speed [m/s]", "Force [N]"
SPREAD = "bounds measured"  # the style of a band of measured forces
MAX_ROWS = 60  # of a table on the page, about; the CSV file has all
WIDTH_SHARES = {0.25: "Width at 25\N{NO-BREAK SPACE}% of the peak speed [N]", 0.5: "at 50\N{NO-BREAK SPACE}%"}
WIDTH_SHARES |= {0.75: "at 75\N{NO-BREAK SPACE}%"}  # at which the page shows the hysteresis
MISSING = "–"
CONDITION = ("current_A", "amplitude_m", "frequency_Hz", "cycles")
OneRow = TypeVar("OneRow", bound=ConditionRow)


def write_characteristics(folder: str | Path, results: Characteristics, head: PageHead) -> list[Path]:
    """Write the page and the tables into `folder`, which is made if it does not exist; return the files, page first.

    Files of an earlier run are replaced, each only when its new content is complete.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    texts = {f"{table}.csv": rows_as_csv(row, getattr(results, table)) for table, row in TABLES.items()}
    fields = [(table, field) for table, row in TABLES.items() for field in row_fields(row).values()]
    described = [(table, field.name, field.unit, field.meaning) for table, field in fields]
    texts[COLUMNS] = as_csv([("table", "column", "unit", "meaning"), *described])
    for name, text in texts.items():
        write_atomically(folder / name, text)
    write_atomically(folder / PAGE, format_page(results, head))
    return [folder / name for name in (PAGE, *texts)]


def format_page(results: Characteristics, head: PageHead) -> str:
    """Return the page as self-contained HTML."""
    palette = Palette(results.sources, tuple(sorted({row.current_A for row in results.peak_velocity})))
    loops = [loop_charts(results, palette, n, point) for n, point in enumerate(choose_test_points(results))]
    responses, motions = list(response_charts(results)), list(motion_charts(results))
    peaks = [peak_chart(results, palette), work_chart(results, palette)] if results.peak_velocity else []
    family = [family_chart(results)] if results.speed_bins else []
    plots = [*family, *peaks, *(plot for pair in loops for plot in pair), *responses, *motions]
    limit = share_points(sum(len(area.marks) for plot in plots for area in plot.areas))

    def draw(some: Sequence[Plot]) -> list[tuple[Markup, str]]:
        return [(draw_plot(plot, limit), plot.title) for plot in some]

    beside = f" beside {join_names(results.sources[1:])}" if len(results.sources) > 1 else ""
    long_tables = (peak_table, work_table, zero_speed_table, width_table)
    short_tables = (response_table, recording_table, omission_table)
    page = page_template("characteristics.html.j2", "ces_identify.characteristics", ("characteristics.css",)).render(
        head=head.titled(f"Characteristics: {join_names([r.name for r in results.recordings])}{beside}"),
        results=results,
        simulations=results.sources[1:],
        tolerance=format_decimal(results.current_tolerance_A),
        family=draw(family),
        peaks=draw(peaks),
        loops=[draw(pair) for pair in loops],
        responses=draw(responses),
        motions=draw(motions),
        **{make.__name__: choose_rows(make(results)) for make in long_tables},
        **{make.__name__: make(results) for make in short_tables},
    )
    return replace_unencodable(page)


@summarize_result.register
def _(results: Characteristics) -> tuple[Sequence[str], Table[Any]]:
    used, total = (sum(getattr(r, name) for r in results.recordings) for name in ("cycles_used", "cycles"))
    about = f"{join_names([r.name for r in results.recordings])}: {used} of {total} cycles repeat at a constant current"
    reasons = [f"{row.subject}: {row.reason}" for row in results.omissions if row.recording == "all"]
    return [about, *reasons], choose_rows(peak_table(results))


def peak_table(results: Characteristics) -> Table[PeakForce]:
    """Return a row for each condition and direction: measured force, and each simulation's with its difference."""
    columns = columns_of(PeakForce, *CONDITION, "direction", "speed_m_s", "force_N")
    columns += _list_simulated(results, results.peak_velocity, "force_N", "difference_N")
    title = "force at the peak speed (± standard deviation between cycles)"
    return Table(columns, _select_measured(results.peak_velocity), title)


def work_table(results: Characteristics) -> Table[CycleWork]:
    """Return a row for each condition: measured work, and each simulation's with its difference, or what it implies."""
    alone = len(results.sources) == 1  # in a terminal there is room for one or the other
    implied = columns_of(CycleWork, "damping_Ns_m", "zero_width_N", "rebound_ratio")
    implied[1] = replace(implied[1], terminal_only=True)  # a table of its own on pages
    columns = columns_of(CycleWork, *CONDITION, "work_J")
    columns += _list_simulated(results, results.work, "work_J", "difference_J")
    columns += implied if alone else [replace(column, page_only=True) for column in implied[::2]]
    others = ", equivalent damping, hysteresis at zero speed, rebound over compression" if alone else ""
    return Table(columns, _select_measured(results.work), f"work per cycle{others}")


def zero_speed_table(results: Characteristics) -> Table[CycleWork]:
    """Return a row for each condition: the measured forces at zero speed."""
    columns = columns_of(CycleWork, *CONDITION, "zero_width_N", "zero_width_per_ms_N", "mid_force_N")
    return Table(columns, _select_measured(results.work))


def width_table(results: Characteristics) -> Table[tuple[ContinuousForce, ...]]:
    """Return the hysteresis width at WIDTH_SHARES of the peak speed; a row is a curve: its points at all SHARES."""
    size, rows = len(SHARES), results.continuous
    at = {share: int(abs(SHARES - share).argmin()) for share in WIDTH_SHARES}
    (width, force) = columns_of(ContinuousForce, "width_N", "force_N")
    columns = [_of_point(0, column) for column in columns_of(ContinuousForce, *CONDITION, "source", "direction")]
    columns += [_of_point(at[share], replace(width, heading=heading)) for share, heading in WIDTH_SHARES.items()]
    columns.append(_of_point(at[0.5], replace(force, heading="Force at 50\N{NO-BREAK SPACE}% [N]")))
    return Table(columns, [rows[k : k + size] for k in range(0, len(rows), size)])


def response_table(results: Characteristics) -> Table[ValveResponse]:
    """Return a row for each kind of step and source, times in ms."""
    names = ("from_A", "to_A", "direction", "source", "steps", "speed_m_s", "force_change_N")
    times = ("dead_time_s", "time_constant_s", "time_63_s", "rise_s")
    title = "response of the valve (± half the 95 % interval)"
    return Table(columns_of(ValveResponse, *names, *times), results.responses, title)


def recording_table(results: Characteristics) -> Table[RecordingFacts]:
    """Return a row for each recording: what the results rest on."""
    return Table(columns_of(RecordingFacts), results.recordings)


def omission_table(results: Characteristics) -> Table[Omission]:
    """Return a row for each reason why something in a recording was not used."""
    return Table(columns_of(Omission), [omission for omission in results.omissions if omission.recording != "all"])


def choose_rows(table: Table[Any]) -> Table[Any]:
    """Return a table for the page: of many rows, those of evenly chosen conditions of each current."""
    conditions: dict[float, dict[tuple[float, float], list[Any]]] = {}
    for row in table.rows:
        point = row[0] if isinstance(row, tuple) else row
        of_current = conditions.setdefault(point.current_A, {})
        of_current.setdefault((point.amplitude_m, point.frequency_Hz), []).append(row)
    every = max(1, math.ceil(len(table.rows) / MAX_ROWS))
    shown = [row for own in conditions.values() for some in list(own.values())[::every] for row in some]
    return replace(table, rows=shown, left_out=len(table.rows) - len(shown))


def _of_point(number: int, column: Column[Any]) -> Column[Any]:
    """Return a column of one point of a curve."""
    return replace(column, text=lambda curve: column.text(curve[number]))


def _select_measured(rows: Sequence[OneRow]) -> list[OneRow]:
    return [row for row in rows if row.source == MEASURED]


def _list_simulated(results: Characteristics, rows: Sequence[ConditionRow], *names: str) -> list[Column[Any]]:
    """Return each simulation's value and difference; a terminal has room for the values of one simulation only."""

    def condition(row: ConditionRow) -> tuple[Any, ...]:
        return row.current_A, row.amplitude_m, row.frequency_Hz, getattr(row, "direction", "")

    def of_source(source: str, column: Column[Any]) -> Column[Any]:
        same = {condition(row): row for row in rows if row.source == source}
        return replace(column, text=lambda row: column.text(same[key]) if (key := condition(row)) in same else MISSING)

    columns, several = [], len(results.sources) > 2
    for source in results.sources[1:] if rows else ():
        value, difference = (row_fields(type(rows[0]))[name] for name in names)
        value = replace(value, heading=source, short="" if several else source, spread="")
        difference = replace(difference, short=f"{source} difference" if several else "difference")
        columns += [of_source(source, replace(value.column, head_css="as-is")), of_source(source, difference.column)]
    return columns


@dataclass(frozen=True)
class Palette:
    """Name and colour of a line by source and current."""

    sources: tuple[str, ...]
    currents: tuple[float, ...]

    def style(self, source: str, current: float) -> tuple[str, str]:
        """Return the entry of the legend and the classes of a line; more than CURVES curves take half shades, too."""
        if len(self.sources) >= MANY_SOURCES:
            return source, "measured" if source == MEASURED else series_css(self.sources.index(source))
        number, count = int(np.argmin(np.abs(np.array(self.currents) - current))), len(self.currents)
        curve = curve_css(number, count)
        if count > CURVES:
            step = round(number * 2 * (CURVES - 1) / (count - 1))
            curve = f"curve c{step // 2}{' half' if step % 2 else ''}"
        name = f"{current:.3g} A"
        return (name, curve) if source == MEASURED else (f"{name}, {source}", f"{curve} beyond")

    @property
    def scale(self) -> PlotScale | None:
        """The colours from the lowest to the highest current; None where colours show sources."""
        if len(self.sources) >= MANY_SOURCES or not self.currents:
            return None
        styles = [self.style(MEASURED, current)[1] for current in self.currents]
        return PlotScale(list(dict.fromkeys(styles)), f"Current {self.currents[0]:.3g}", f"{self.currents[-1]:.3g} A")


def choose_test_points(results: Characteristics) -> list[CycleWork]:
    """Return a row of each point whose loops are shown: slowest, middle, fastest of those run at the most currents."""
    points: list[tuple[CycleWork, set[float]]] = []
    for row in results.work:
        currents = next((currents for point, currents in points if _same_test(point, row)), None)
        if currents is None:
            points.append((row, currents := set()))
        currents.add(row.current_A)
    most = max((len(currents) for _, currents in points), default=0)
    full = sorted((point for point, currents in points if len(currents) == most), key=_sine_speed)
    chosen = np.unique(np.rint(np.linspace(0, len(full) - 1, min(MAX_TEST_POINTS, len(full)))).astype(int))
    return [full[k] for k in chosen]


def _same_test(row: ConditionRow, other: ConditionRow) -> bool:
    """Return whether two rows have nearly the same amplitude and frequency."""
    ratios = np.array([other.amplitude_m / row.amplitude_m, other.frequency_Hz / row.frequency_Hz])
    return bool((np.abs(np.log(ratios)) <= SAME_TEST).all())


def _sine_speed(row: ConditionRow) -> float:
    """Return the peak speed [m/s] of a sine."""
    return 2.0 * np.pi * row.amplitude_m * row.frequency_Hz


def family_chart(results: Characteristics) -> Plot:
    """Return the force over speed at each current: points measured in any motion, and a curve for each simulation."""
    groups = dict.fromkeys((row.current_from_A, row.current_to_A) for row in results.speed_bins)
    palette = Palette(results.sources, tuple(0.5 * (low + high) for low, high in groups))
    marks: list[PlotMark] = []
    for source in results.sources:
        for current, group in zip(palette.currents, groups, strict=True):
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
    title, areas = "Force at the peak speed of each cycle", [PlotArea(FORCE, marks, height=330, y_ticks=8)]
    text = "Mean force at the peak speed of compression (right) and rebound (left), a curve for each current."
    return Plot("peak-velocity", title, text, "Peak speed [m/s]", areas, width=900.0, free=True, scale=palette.scale)


def loop_charts(results: Characteristics, palette: Palette, number: int, point: ConditionRow) -> tuple[Plot, Plot]:
    """Return force over stroke and force over speed of the mean cycle at one test point."""
    what = f"{1e3 * point.amplitude_m:.3g} mm, {point.frequency_Hz:.3g} Hz"
    loops: dict[tuple[int, float, float, float], list[LoopPoint]] = {}
    for row in results.loops:
        key = results.sources.index(row.source), row.current_A, row.amplitude_m, row.frequency_Hz
        loops.setdefault(key, []).append(row)
    shown = [rows for _, rows in sorted(loops.items(), key=lambda item: item[0][0]) if _same_test(point, rows[0])]

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
            if strokes and row.amplitude_m <= (1.0 + SAME_TEST) * strokes[-1][0].amplitude_m:
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


def response_charts(results: Characteristics) -> Iterator[Plot]:
    """Yield the mean normalised response to steps in each direction of motion with steps."""
    for direction in DIRECTIONS:
        marks: list[PlotMark] = []
        enough = [row for row in results.response_points if row.steps >= DynoLimits.MIN_REPEATS]
        rows = [row for row in enough if row.direction == direction]
        for n, key in enumerate(dict.fromkeys((round(r.from_A, 6), round(r.to_A, 6), r.source) for r in rows)):
            points = [r for r in rows if (round(r.from_A, 6), round(r.to_A, 6), r.source) == key]
            t, y, spread = (_values(points, name) for name in ("time_s", "share", "share_sd"))
            if key[2] == MEASURED:
                marks.insert(0, PlotBand("± standard deviation, measured", 1e3 * t, y - spread, y + spread, SPREAD))
            marks.append(PlotLine(f"{key[0]:.2g} to {key[1]:.2g} A, {key[2]}", 1e3 * t, y, series_css(n)))
        if marks:
            text = f"Mean change of force after a step of the current in {direction}; band: standard deviation"
            title = f"Response to steps of the current, {direction}"
            areas = [PlotArea("Share of the change of force", marks, height=230)]
            x_label, width = "Time since the step [ms]", 550.0
            yield Plot(f"response-{direction}", title, f"{text} between steps.", x_label, areas, width)


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
