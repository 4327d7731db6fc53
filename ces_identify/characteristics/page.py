"""The page of characteristics: charts and tables, measured beside simulated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup

from ces_identify.characteristics.cycle_values import DIRECTIONS, SHARES
from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.page_charts import (
    loop_charts,
    motion_charts,
    peak_chart,
    response_chart,
    work_chart,
)
from ces_identify.characteristics.palette import choose_test_points, make_palette
from ces_identify.characteristics.results import Characteristics
from ces_identify.characteristics.rows import ConditionRow
from ces_identify.report.plot import Plot, draw_plot, share_points
from ces_identify.report.shell import command_block, page_template, replace_unencodable
from ces_identify.typesetting import join_names, minus
from ces_observer.json_checks import write_atomically

TITLE = "Characteristics"
MAX_ROWS = 60  # of a table on the page, about; the CSV file has all
MAX_OPEN_ROWS = 20  # of a table that is not folded
WIDTH_SHARES = (0.25, 0.5, 0.75)  # of the peak speed, at which the page shows the hysteresis
MISSING = "–"


class TableRows(NamedTuple):
    """The rows of a table that the page shows, and how many there are."""

    shown: list[dict[str, Any]]
    total: int


def write_page(path: Path, results: Characteristics, command: str = "") -> None:
    """Write the page to `path`; an existing file stays unchanged if that fails."""
    write_atomically(path, format_page(results, command))


def format_page(results: Characteristics, command: str = "") -> str:
    """Return the page as self-contained HTML."""
    palette, points = make_palette(results), choose_test_points(results)
    loops = [loop_charts(results, palette, n, point) for n, point in enumerate(points)]
    responses = [chart for d in DIRECTIONS if (chart := response_chart(results, d, palette)) is not None]
    motions = list(motion_charts(results))
    peaks = [peak_chart(results, palette), work_chart(results, palette)] if results.peak_velocity else []
    plots = [*peaks, *(plot for pair in loops for plot in pair), *responses, *motions]
    limit = share_points(sum(len(area.marks) for plot in plots for area in plot.areas))

    def draw(some: Sequence[Plot]) -> list[tuple[Markup, str]]:
        return [(draw_plot(plot, limit), plot.title) for plot in some]

    beside = f" beside {join_names(results.sources[1:])}" if len(results.sources) > 1 else ""
    page = page_template("characteristics.html.j2", "ces_identify.characteristics", ("characteristics.css",)).render(
        title=f"{TITLE}: {join_names([r.name for r in results.recordings])}{beside}",
        command=command_block(command) if command else "",
        results=results,
        simulations=results.sources[1:],
        peaks=draw(peaks),
        loops=[draw(pair) for pair in loops],
        responses=draw(responses),
        motions=draw(motions),
        peak_rows=choose_rows(peak_cells(results)),
        work_rows=choose_rows(work_cells(results)),
        width_rows=choose_rows(width_cells(results)),
        knee_rows=choose_rows(knee_cells(results)),
        response_rows=list(response_cells(results)),
        fold=MAX_OPEN_ROWS,
        number=number,
        spread=with_spread,
    )
    return replace_unencodable(page)


def choose_rows(cells: Iterable[dict[str, Any]]) -> TableRows:
    """Return the rows of a table for the page: of many, those of evenly chosen conditions of each current."""
    rows = list(cells)
    conditions: dict[float, dict[tuple[float, float], list[dict[str, Any]]]] = {}
    for cell in rows:
        row = cell["row"]
        of_current = conditions.setdefault(row.current_A, {})
        of_current.setdefault((row.amplitude_m, row.frequency_Hz), []).append(cell)
    every = max(1, math.ceil(len(rows) / MAX_ROWS))
    shown = [cell for own in conditions.values() for some in list(own.values())[::every] for cell in some]
    return TableRows(shown, len(rows))


def peak_cells(results: Characteristics) -> Iterator[dict[str, Any]]:
    """Yield a row for each condition and direction: measured force, and each simulation's with its difference."""
    for row in results.peak_velocity:
        if row.source == MEASURED:
            same = [r for r in results.peak_velocity if _same(r, row) and r.direction == row.direction]
            yield {
                "row": row,
                "force": with_spread(row.force_N, row.force_sd_N, 4),
                "others": [
                    (number(r.force_N, 4), with_spread(r.difference_N, r.difference_sd_N))
                    for r in _others(results, same)
                ],
            }


def work_cells(results: Characteristics) -> Iterator[dict[str, Any]]:
    """Yield a row for each condition: measured work, and each simulation's with its difference."""
    for row in results.work:
        if row.source == MEASURED:
            same = [r for r in results.work if _same(r, row)]
            others = [
                (number(r.work_J, 4), with_spread(r.difference_J, r.difference_sd_J)) for r in _others(results, same)
            ]
            yield {"row": row, "work": with_spread(row.work_J, row.work_sd_J, 4), "others": others}


def width_cells(results: Characteristics) -> Iterator[dict[str, Any]]:
    """Yield a row for each condition and direction: the width of the hysteresis at WIDTH_SHARES of the peak speed."""
    size = len(SHARES)
    rows = results.continuous
    wanted = [int(abs(SHARES - share).argmin()) for share in WIDTH_SHARES]
    for first in range(0, len(rows), size):
        one = rows[first : first + size]
        yield {
            "row": one[0],
            "widths": [with_spread(one[k].width_N, one[k].width_sd_N) for k in wanted],
            "force": number(one[wanted[1]].force_N, 4),
        }


def knee_cells(results: Characteristics) -> Iterator[dict[str, Any]]:
    """Yield a row for each knee that was found."""
    for row in results.knees:
        if not row.note:
            yield {
                "row": row,
                "speed": with_spread(row.knee_speed_m_s, row.knee_speed_sd_m_s),
                "force": number(row.knee_force_N),
                "slopes": (number(row.slope_below_Ns_m), number(row.slope_above_Ns_m)),
            }


def response_cells(results: Characteristics) -> Iterator[dict[str, Any]]:
    """Yield a row for each kind of step and source, times in ms."""
    for row in results.responses:
        names = ("dead_time", "time_constant", "time_63", "rise")
        times = [with_spread(1e3 * getattr(row, f"{n}_s"), 1e3 * getattr(row, f"{n}_ci95_s")) for n in names]
        yield {"row": row, "times": times, "change": number(row.force_change_N)}


def number(value: float, figures: int = 3) -> str:
    """Return a number with `figures` figures and a minus sign, a dash for NaN."""
    if not math.isfinite(value):
        return MISSING
    digits = figures - 1 - (math.floor(math.log10(abs(value))) if value else 0)
    return minus(f"{round(value, digits):.{max(digits, 0)}f}")


def with_spread(value: float, spread: float, figures: int = 3) -> str:
    """Return `value ± spread`; without a spread the value with `figures` figures.

    The spread has one figure, or two if it begins with 1 or 2; the value is rounded to the same place.
    """
    if not (math.isfinite(value) and math.isfinite(spread) and spread > 0.0):
        return number(value, figures)
    decade = math.floor(math.log10(spread))
    digits = (1 if spread < 3.0 * 10.0**decade else 0) - decade
    return minus(f"{round(value, digits):.{max(digits, 0)}f} ± {round(spread, digits):.{max(digits, 0)}f}")


def _same(one: ConditionRow, other: ConditionRow) -> bool:
    names = ("current_A", "amplitude_m", "frequency_Hz")
    return all(getattr(one, name) == getattr(other, name) for name in names)


def _others(results: Characteristics, rows: Sequence[Any]) -> list[Any]:
    """Return the rows of the simulations in their order."""
    return [row for source in results.sources[1:] for row in rows if row.source == source]
