"""A comparison for people and programs: its tables, its self-contained page, and its document.

The page holds verdicts, costs, differences, and overlaid forces.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_identify.comparison.compared_models import TRAINED, AlignedRecording, Difference, PairResult
from ces_identify.comparison.comparison import (
    Comparison,
    ModelResult,
    RecordingCost,
    describe_interval,
    format_signed,
    headline,
    p_text,
)
from ces_identify.limits import ComparisonLimits
from ces_identify.validation.cost_table import NONE, interval_text, percent
from ces_identify.validation.evaluate import CostInterval, find_working_windows
from ces_observer.json_text import write_atomically
from ces_report.plot import IntervalRow, Plot, PlotArea, PlotLine, draw_intervals, draw_plot, series_css, share_points
from ces_report.shell import command_block, page_template, replace_unencodable
from ces_report.table import Column, Table
from ces_report.typesetting import join_with

TOO_SHORT = "too short"
WINDOW_S = 1.5  # shown first
LOOP_POINTS = 900
LINES_OF_MODEL, LINES_OF_RECORDING = 4, 3  # in the charts of a recording
MAX_OPEN_ROWS = 20  # of a table that is not folded
MAX_DETAILED_PAIRS = 3  # pairs of models up to which the differences on each recording are drawn
NAMES_IN_TITLE = 4


def model_table(comparison: Comparison) -> Table[int]:
    """Return a row for each model with what it is."""

    def text(of: Callable[[ModelResult], object | None], form: str = "") -> Callable[[int], str]:
        return lambda i: NONE if (value := of(comparison.models[i])) is None else f"{value:{form}}"

    columns: list[Column[int]] = [
        Column("model", text(lambda m: m.name)),
        Column("size", text(lambda m: None if m.model.model is None else m.model.model.size)),
        Column(
            "bound kN", text(lambda m: None if m.force_bound_N is None else m.force_bound_N / 1000, ".4g"), figure=True
        ),
        Column("out %", lambda i: outside_percent(comparison, i, NONE), figure=True),
    ]
    return Table(columns, range(len(comparison.models)), "models")


def outside_percent(comparison: Comparison, model: int, missing: str) -> str:
    """Return the largest share [%] of a recording's ticks with some signal outside the model's envelope."""
    if comparison.models[model].model.model is None:
        return missing
    shares = [max((use.outside_share for use in r.exits[model]), default=0.0) for r in comparison.recordings]
    return f"{100 * max(shares):.1f}"


def recording_table(comparison: Comparison) -> Table[tuple[int, int]]:
    """Return a row for each model (second index) on each recording (first)."""
    recordings, models = comparison.recordings, comparison.models

    def name(row: tuple[int, int]) -> str:
        return f"{recordings[row[0]].name}, {recordings[row[0]].seconds:.1f} s" if row[1] == 0 else ""

    def of_cost(text: Callable[[RecordingCost], str]) -> Callable[[tuple[int, int]], str]:
        return lambda row: text(models[row[1]].costs[row[0]])

    columns: list[Column[tuple[int, int]]] = [
        Column("recording", name),
        Column("model", lambda row: models[row[1]].name),
        Column("use", of_cost(lambda cost: cost.use)),
        Column("J %", of_cost(lambda cost: percent(cost.cost)), figure=True),
        Column("95 %", of_cost(lambda cost: interval_text(cost.interval)), figure=True),
        Column("RMS N", of_cost(lambda c: f"{c.rms_N:.1f}" if math.isfinite(c.rms_N) else NONE), figure=True),
    ]
    rows = [(n, i) for n in range(len(recordings)) for i in range(len(models))]
    return Table(columns, rows, "each recording", group=lambda row: row[0])


def pair_table(comparison: Comparison) -> Table[PairResult]:
    """Return a row for each pair of models with the difference of their costs."""
    models = comparison.models

    def sort_value(value: float | None) -> object:
        return "" if value is None or math.isnan(value) else value

    def better(pair: PairResult) -> str:
        return pair.verdict if pair.better is None else f"{'first' if pair.better == pair.first else 'second'} better"

    pages: list[Column[PairResult]] = [
        Column("First − second", lambda p: f"{models[p.first].name} − {models[p.second].name}"),
        Column("On", lambda p: join_with(p.pooled.recordings)),
        Column(
            "Difference of J [%]",
            lambda p: difference_text(p.pooled),
            figure=True,
            value=lambda p: sort_value(p.pooled.value),
        ),
        Column("p", lambda p: p_text(p.p_value).replace("-", "–"), figure=True, value=lambda p: sort_value(p.p_value)),
        Column("Verdict", lambda p: p.verdict if p.better is None else f"{models[p.better].name} is better"),
    ]
    if len({pair.pooled.recordings for pair in comparison.pairs}) == 1:
        del pages[1]
    terminals: list[Column[PairResult]] = [
        Column("first", lambda p: models[p.first].name),
        Column("second", lambda p: models[p.second].name),
        Column("J", lambda p: format_signed(p.pooled.value) if math.isfinite(p.pooled.value) else NONE, figure=True),
        Column("interval", lambda p: describe_interval(p.pooled), figure=True),
        Column("p", lambda p: p_text(p.p_value), figure=True),
        Column("verdict", better),
    ]
    columns = [replace(c, page_only=True) for c in pages] + [replace(c, terminal_only=True) for c in terminals]
    return Table(columns, comparison.pairs, "differences of J, first minus second")


def difference_text(difference: Difference) -> str:
    """Return a difference with its interval, or why there is none."""
    if not math.isfinite(difference.value):
        return "diverged"
    return f"{format_signed(difference.value)} ({describe_interval(difference, TOO_SHORT)})"


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison as mappings, lists, texts and numbers."""
    names = [model.name for model in comparison.models]
    return {
        "part": list(comparison.part),
        "recordings": [
            {"name": r.name, "source": r.source, "sha256": r.sha256, "scored_s": round(r.seconds, 3)}
            for r in comparison.recordings
        ],
        "test_recordings": list(comparison.test_names),
        "models": [_model_facts(i, comparison) for i in range(len(names))],
        "pairs": [_pair_facts(pair, names) for pair in comparison.pairs],
        "notes": comparison.notes(),
    }


def _model_facts(i: int, comparison: Comparison) -> dict[str, Any]:
    result, model = comparison.models[i], comparison.models[i].model.model
    return {
        "name": result.name,
        "source": result.model.source,
        "structure": None if model is None else model.structure,
        "size": None if model is None else model.size,
        "rate_Hz": None if model is None else model.sampling.rate_Hz,
        "delay_s": None if model is None else model.sampling.delay_s,
        "costs": [
            {
                "recording": cost.recording,
                "use": cost.use,
                "J_percent": cost.cost,
                "ci95_percent": _ends(cost.interval),
                "rms_N": cost.rms_N,
                "outside_envelope": [asdict(use) for use in recording.exits[i]],
            }
            for cost, recording in zip(result.costs, comparison.recordings, strict=True)
        ],
        "pooled": {"J_percent": result.pooled, "ci95_percent": _ends(result.pooled_interval)},
        "force_bound_N": result.force_bound_N,
    }


def _pair_facts(pair: PairResult, names: list[str]) -> dict[str, Any]:
    return {
        "first": names[pair.first],
        "second": names[pair.second],
        "verdict": pair.verdict,
        "better": None if pair.better is None else names[pair.better],
        "p_value": pair.p_value,
        "pooled": _difference(pair.pooled),
        "each": [_difference(difference) for difference in pair.each],
        "text": pair.text,
    }


def _difference(difference: Difference) -> dict[str, Any]:
    return {
        "recordings": list(difference.recordings),
        "first_minus_second_percent": difference.value,
        "interval_percent": None if difference.low is None else [difference.low, difference.high],
    }


def _ends(interval: CostInterval | None) -> list[float] | None:
    return None if interval is None else [interval.low, interval.high]


def write_comparison(path: Path, comparison: Comparison, command: str) -> None:
    """Write the page to `path`, as a whole or not at all; raises CesError. The page shows the `command`."""
    write_atomically(path, comparison_page(comparison, command))


def comparison_page(comparison: Comparison, command: str = "") -> str:
    """Return the page as HTML that is also well-formed XML."""
    models, tests = comparison.models, comparison.test_names
    all_pairs = len(comparison.pairs) <= MAX_DETAILED_PAIRS
    page = page_template("comparison.html.j2", __package__ or "", ("comparison.css",)).render(
        title=f"{_name_some([model.name for model in models], 'models')} on "
        f"{_name_some([r.name for r in comparison.recordings], 'recordings')}",
        headline=headline(comparison),
        warnings=comparison.notes(),
        command=command_block(command) if command else "",
        comparison=comparison,
        pooled_over=join_with(tests) if tests else "",
        rows=[_model_row(comparison, i) for i in comparison.by_cost],
        pairs=pair_table(comparison),
        forest=_draw_differences(comparison) if all_pairs else _draw_above_lowest(comparison),
        all_pairs=all_pairs,
        best=models[comparison.best].name,
        recordings=[
            {
                "recording": comparison.recordings[n],
                "charts": draw_overlay(comparison, n),
                "costs": [m.costs[n] for m in models],
            }
            for n in comparison.drawn_recordings
        ],
        fold=MAX_OPEN_ROWS,
        swatches=[_swatch(comparison, i) for i in range(len(models))],
        notes_on_charts=[note[0].upper() + note[1:] for note in comparison.notes_on_charts()],
        trained=TRAINED,
        interval=_page_interval,
        percent=percent,
    )
    return replace_unencodable(page)


def _page_interval(interval: CostInterval | None) -> str:
    """Return an interval of J as text, a dash if there is none."""
    return "–" if interval is None else f"{interval.low:.2f} to {interval.high:.2f}"


def _name_some(names: list[str], kind: str) -> str:
    return join_with(names) if len(names) <= NAMES_IN_TITLE else f"{len(names)} {kind}"


def _model_row(comparison: Comparison, i: int) -> dict[str, Any]:
    result, model = comparison.models[i], comparison.models[i].model.model
    difference, lowest = comparison.above_lowest(i), "lowest" if i == comparison.best else "–"
    bound = "–" if model is None else "not proved"
    return {
        "name": result.name,
        "swatch": _swatch(comparison, i),
        "size": "not a model" if model is None else model.size,
        "rate": "–" if model is None else f"{model.sampling.rate_Hz:g}",
        "delay": result.delay_ms.replace(NONE, "–"),
        "cost": percent(result.pooled),
        "interval": _page_interval(result.pooled_interval),
        "above": lowest if difference is None else format_signed(difference.value),
        "above_interval": "" if difference is None else describe_interval(difference, TOO_SHORT),
        "bound": bound if result.force_bound_N is None else f"{result.force_bound_N / 1000:.4g}",
        "outside": outside_percent(comparison, i, "–"),
        "costs": result.costs,
    }


def _draw_differences(comparison: Comparison) -> Markup:
    """Return a row for each pair and, below it, one for each recording if there are several."""
    rows = []
    for pair in comparison.pairs:
        name = f"{comparison.models[pair.first].name} − {comparison.models[pair.second].name}"
        rows.append(_row(name, pair.pooled, "outline", starts=True))
        for n, difference in enumerate(pair.each if len(comparison.recordings) > 1 else ()):
            trained = any(comparison.models[i].costs[n].use == TRAINED for i in (pair.first, pair.second))
            name = f"{difference.recordings[0]}{' (no test)' if trained else ''}"
            rows.append(_row(name, difference, "envelope", starts=False))
    title, label = "Differences of cost between the models", "J of the first minus J of the second [%]"
    return draw_intervals("differences", title, label, rows, zero=True)


def _draw_above_lowest(comparison: Comparison) -> Markup:
    """Return a row for each other model: how much its cost is above the lowest."""
    models, best = comparison.models, comparison.best
    rows = [
        _row(models[i].name, comparison.pair(best, i).minus(best), _css(comparison, i), starts=True)
        for i in comparison.by_cost[1:]
    ]
    title = f"Costs of the models above that of {models[best].name}"
    return draw_intervals("differences", title, "J above the lowest [%]", rows, zero=True)


def _row(name: str, difference: Difference, css: str, *, starts: bool) -> IntervalRow:
    nan = float("nan")
    low, high = (nan, nan) if difference.low is None or difference.high is None else (difference.low, difference.high)
    return IntervalRow(name, low, high, difference.value, difference_text(difference), css, starts, not starts)


def _css(comparison: Comparison, i: int) -> str:
    """Return the class of a model's colour; one that no chart of forces shows has none of its own."""
    return series_css(comparison.drawn.index(i)) if i in comparison.drawn else "outline"


def _swatch(comparison: Comparison, i: int) -> Markup:
    if i not in comparison.drawn:
        return Markup("")
    return Markup(
        '<svg class="plot-swatch" viewBox="0 0 22 10" aria-hidden="true"><path class="{}" d="M1,5h20"/></svg>'
    ).format(_css(comparison, i))


def draw_overlay(comparison: Comparison, number: int) -> dict[str, Any]:
    """Return the charts of the recording `number`, and the window [s] that they show first."""
    whole = comparison.recordings[number]
    recording = replace(whole, forces=whole.forces[list(comparison.drawn)])
    names = [comparison.models[i].name for i in comparison.drawn]
    first, last = choose_window(recording)
    lines = len(comparison.drawn_recordings) * (LINES_OF_RECORDING + LINES_OF_MODEL * len(names))
    points = share_points(lines)
    view = (float(recording.time_s[first]), float(recording.time_s[last - 1]))
    return {
        "over_time": draw_plot(_time_plot(recording, names, number, view), points),
        "over_speed": draw_plot(_loop_plot(recording, names, number, slice(first, last)), points),
        "from_s": view[0],
        "to_s": view[1],
    }


def choose_window(recording: AlignedRecording) -> tuple[int, int]:
    """Return the samples [first, last) of the window where the damper works with the median error of all models."""
    length = max(2, round(WINDOW_S * recording.rate_Hz))
    n = len(recording.time_s)
    if length >= n:
        return 0, n
    squares = np.nansum((recording.measured - recording.forces) ** 2, axis=0)
    starts, means = find_working_windows(length, recording.scored, recording.measured, recording.speed, squares)
    first = int(starts[np.argsort(means, kind="stable")[len(means) // 2]])
    return first, first + length


def _time_plot(recording: AlignedRecording, names: list[str], number: int, view: tuple[float, float]) -> Plot:
    t, breaks = recording.time_s, np.diff(recording.time_s, prepend=recording.time_s[0]) > ComparisonLimits.MAX_GAP_S
    forces, errors = [PlotLine("measured", t, recording.measured, "measured reference", breaks)], []
    for i, (name, force) in enumerate(zip(names, recording.forces, strict=True)):
        error = np.where(recording.scored, recording.measured - force, np.nan)
        forces.append(PlotLine(name, t, force, series_css(i), breaks))
        errors.append(PlotLine(name, t, error, series_css(i), breaks))
    areas = [
        PlotArea("Force [N]", forces, 190),
        PlotArea("Measured minus simulated [N]", errors, 110, around_zero=True),
        PlotArea("The same over the whole recording [N]", errors, 50, around_zero=True, whole=True),
    ]
    text = f"Measured force of {recording.name} and the free runs of {len(names)} models, with their errors below."
    return Plot(f"time{number}", f"Force over time, {recording.name}", text, "Time [s]", areas, 660, view, f"r{number}")


def _loop_plot(recording: AlignedRecording, names: list[str], number: int, window: slice) -> Plot:
    some = slice(window.start, window.stop, -(-(window.stop - window.start) // LOOP_POINTS))
    v = recording.speed[some]
    lines = [PlotLine("measured", v, recording.measured[some], "measured reference")]
    lines += [
        PlotLine(name, v, f[some], series_css(i))
        for i, (name, f) in enumerate(zip(names, recording.forces, strict=True))
    ]
    text = f"Force of {recording.name} over piston speed, measured and simulated, in the window shown first."
    area = PlotArea("Force [N]", lines, 380)
    return Plot(
        f"loop{number}", f"Force over speed, {recording.name}", text, "Speed [m/s]", [area], 440, free=True, x_ticks=5
    )
