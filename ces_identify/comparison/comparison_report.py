"""A comparison for people and programs: its headline, tables, self-contained page, and document.

The page holds verdicts, costs, differences, and overlaid forces.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_identify.comparison.compared_models import (
    BETTER,
    DIVERGED,
    NO_TEST,
    SAME,
    SHORT,
    TRAINED,
    AlignedRecording,
    Difference,
    PairResult,
)
from ces_identify.comparison.comparison import Comparison, Pairs, RecordingCost
from ces_identify.limits import TickLimits
from ces_identify.validation.cost_table import NONE, interval_text, percent
from ces_identify.validation.evaluate import find_working_windows
from ces_observer.json_text import write_atomically
from ces_report.plot import IntervalRow, Plot, PlotArea, PlotLine, draw_intervals, draw_plot, series_css, share_points
from ces_report.shell import PageHead, page_template, replace_unencodable
from ces_report.table import Column, Table, summarize_result
from ces_report.typesetting import join_with, minus

MAX_NAMES = 3  # of other models in a sentence
LOWEST, TOO_SHORT = "lowest", "too short"
HEADLINES = {
    BETTER: "{best} is better than {others}",
    SAME: "{best} cannot be told apart from {others}",
    SHORT: "too short to know: whether {best} differs from {others}",
    NO_TEST: "no test: {best} or {others} was identified on each recording",
    DIVERGED: "no difference between {best} and {others}: a free run diverged",
}


def headline(comparison: Comparison) -> str:
    """Return what the pooled costs say about the model with the lowest one, against every other."""
    best, count = comparison.best, len(comparison.models) - 1
    parts = []
    for verdict, text in HEADLINES.items():
        others = [i for i in range(count + 1) if i != best and comparison.pair(best, i).verdict == verdict]
        if others:
            shown = join_with([comparison.models[i].name for i in others[:MAX_NAMES]])
            if len(others) > MAX_NAMES:
                shown = f"all {count} others" if len(others) == count else f"{len(others)} of the others"
            parts.append(text.format(best=comparison.models[best].name, others=shown))
    return f"{'; '.join(parts)}."


def format_signed(value: float) -> str:
    """Return a difference [%] with its sign."""
    return minus(f"{round(value, 2) + 0.0:+.2f}")  # no negative zero


def describe_difference(difference: Difference) -> str:
    """Return a difference with its interval, or why there is none."""
    interval = describe_interval(difference)
    return f"{format_signed(difference.value)} ({interval})" if math.isfinite(difference.value) else interval


def describe_interval(difference: Difference) -> str:
    """Return the interval of a difference as text; "diverged" or "too short" without one."""
    low, high = difference.low, difference.high
    if low is None or high is None:
        return TOO_SHORT if math.isfinite(difference.value) else DIVERGED
    return f"{format_signed(low)} to {format_signed(high)}"


def model_table(comparison: Comparison) -> Table[int]:
    """Return a row for each model, lowest cost first: its cost, how much that is above the lowest, and what it is."""
    models, tests = comparison.models, comparison.test_names

    def above(i: int) -> str:
        difference = comparison.above_lowest(i)
        return format_signed(difference.value) if difference else LOWEST if i == comparison.best else NONE

    def above_interval(i: int) -> str:
        difference = comparison.above_lowest(i)
        return describe_interval(difference) if difference else ""

    columns: list[Column[int]] = [
        Column(
            "Model",
            lambda i: models[i].name,
            html=lambda i: Markup("{}<b>{}</b>").format(swatch(comparison, i), models[i].name),
            css="model",
            short="model",
            small=lambda i: models[i].facts[0],
        ),
        Column("Rate [Hz]", lambda i: models[i].facts[1], figure=True, page_only=True),
        Column("Delay [ms]", lambda i: models[i].facts[2], figure=True, short="delay ms"),
        Column(
            "J over all tests [%]" if tests else "J over all, no test [%]",
            lambda i: percent(models[i].pooled, models[i].pooled_interval),
            figure=True,
            short="J %",
            small=lambda i: interval_text(models[i].pooled_interval),
        ),
        Column("Above the lowest [%]", above, figure=True, short="above the lowest", small=above_interval),
        Column("Bound of the force [kN]", lambda i: models[i].bound_kN, figure=True, short="bound kN"),
        Column("Outside envelope [%]", comparison.outside_percent, figure=True, short="out %"),
    ]
    title = f"cost J over {join_with(tests)}" if tests else "cost J over all (not a test)"
    return Table(columns, comparison.by_cost, title)


@summarize_result.register
def _(comparison: Comparison) -> tuple[Sequence[str], Table[int]]:
    return [headline(comparison), *(f"Note: {note}." for note in comparison.notes())], model_table(comparison)


def pair_table(pairs: Sequence[PairResult]) -> Table[PairResult]:
    """Return a row for each pair of models with the difference of their costs."""

    def sort_value(value: float | None) -> object:
        return "" if value is None or math.isnan(value) else value

    def probability(pair: PairResult) -> str:
        return NONE if pair.p_value is None else "< 0.001" if pair.p_value < 0.001 else f"{pair.p_value:.3f}"

    def verdict(pair: PairResult) -> str:
        return pair.verdict if pair.better is None else f"{pair.names[pair.better == pair.second]} is better"

    columns: list[Column[PairResult]] = [
        Column("First", lambda p: p.names[0], short="first"),
        Column("Second", lambda p: p.names[1], short="second"),
        Column("On", lambda p: join_with(p.pooled.recordings), page_only=True),
        Column(
            "First − second, J [%]",
            lambda p: format_signed(p.pooled.value),
            figure=True,
            short="J %",
            value=lambda p: sort_value(p.pooled.value),
            small=lambda p: describe_interval(p.pooled),
        ),
        Column("p", probability, figure=True, value=lambda p: sort_value(p.p_value)),
        Column("Verdict", verdict, short="verdict"),
    ]
    if len({pair.pooled.recordings for pair in pairs}) == 1:
        del columns[2]
    return Table(columns, pairs, "differences of J, first minus second")


@summarize_result.register
def _(pairs: Pairs) -> tuple[Sequence[str], Table[PairResult]]:
    return [], pair_table(pairs)


def swatch(comparison: Comparison, i: int) -> Markup:
    """Return a line in the colour that a model has in the charts; nothing if they do not show it."""
    if i not in comparison.drawn:
        return Markup("")
    return Markup(
        '<svg class="plot-swatch" viewBox="0 0 22 10" aria-hidden="true"><path class="{}" d="M1,5h20"/></svg>'
    ).format(series_css(comparison.drawn.index(i)))


WINDOW_S = 1.5  # shown first
LOOP_POINTS = 900
LINES_OF_MODEL, LINES_OF_RECORDING = 4, 3  # in the charts of a recording
MAX_DETAILED_PAIRS = 3  # pairs of models up to which the differences on each recording are drawn
NAMES_IN_TITLE = 4


def recording_table(comparison: Comparison) -> Table[tuple[int, int]]:
    """Return a row for each model (second index) on each recording (first)."""
    recordings, models = comparison.recordings, comparison.models

    def name(row: tuple[int, int]) -> str:
        return f"{recordings[row[0]].name}, {recordings[row[0]].seconds:.1f} s" if row[1] == 0 else ""

    def of_cost(text: Callable[[RecordingCost], str]) -> Callable[[tuple[int, int]], str]:
        return lambda row: text(models[row[1]].costs[row[0]])

    columns: list[Column[tuple[int, int]]] = [
        Column("Recording", name, short="recording"),
        Column("Model", lambda row: models[row[1]].name, short="model"),
        Column("Use", of_cost(lambda cost: cost.use), short="use"),
        Column("J [%]", of_cost(lambda cost: percent(cost.cost, cost.interval)), figure=True, short="J %"),
        Column("95 % interval [%]", of_cost(lambda cost: interval_text(cost.interval)), figure=True, short="95 %"),
        Column(
            "RMS error [N]",
            of_cost(lambda c: f"{c.rms_N:.1f}" if math.isfinite(c.rms_N) else NONE),
            figure=True,
            short="RMS N",
        ),
    ]
    rows = [(n, i) for n in range(len(recordings)) for i in range(len(models))]
    return Table(columns, rows, "each recording", group=lambda row: row[0])


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison as mappings, lists, texts and numbers."""
    names = [model.name for model in comparison.models]
    return {
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
                "ci95_percent": list(astuple(cost.interval)) if cost.interval else None,
                "rms_N": cost.rms_N,
                "outside_envelope": [asdict(use) for use in recording.exits[i]],
            }
            for cost, recording in zip(result.costs, comparison.recordings, strict=True)
        ],
        "pooled": {
            "J_percent": result.pooled,
            "ci95_percent": list(astuple(result.pooled_interval)) if result.pooled_interval else None,
        },
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


def write_comparison(path: Path, comparison: Comparison, head: PageHead) -> None:
    """Write the page to `path`, as a whole or not at all; raises CesError."""
    write_atomically(path, comparison_page(comparison, head))


def comparison_page(comparison: Comparison, head: PageHead) -> str:
    """Return the page as HTML that is also well-formed XML."""
    models, tests = comparison.models, comparison.test_names
    all_pairs = len(comparison.pairs) <= MAX_DETAILED_PAIRS
    page = page_template("comparison.html.j2", __package__ or "", ("comparison.css",)).render(
        head=head.titled(
            f"{_name_some([model.name for model in models], 'models')} on "
            f"{_name_some([r.name for r in comparison.recordings], 'recordings')}"
        ),
        headline=headline(comparison),
        warnings=comparison.notes(),
        comparison=comparison,
        pooled_over=join_with(tests) if tests else "",
        costs=model_table(comparison),
        each=recording_table(comparison),
        pairs=pair_table(comparison.pairs),
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
        swatches=[swatch(comparison, i) for i in range(len(models))],
        notes_on_charts=[note[0].upper() + note[1:] for note in comparison.notes_on_charts()],
        percent=percent,
    )
    return replace_unencodable(page)


def _name_some(names: list[str], kind: str) -> str:
    return join_with(names) if len(names) <= NAMES_IN_TITLE else f"{len(names)} {kind}"


def _draw_differences(comparison: Comparison) -> Markup:
    """Return a row for each pair and, below it, one for each recording if there are several."""
    rows = []
    for pair in comparison.pairs:
        name = " − ".join(pair.names)
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
    colours = {i: series_css(n) for n, i in enumerate(comparison.drawn)}  # no chart of forces shows the others
    others = {i: comparison.pair(best, i).minus(best) for i in comparison.by_cost[1:]}
    rows = [_row(models[i].name, above, colours.get(i, "outline"), starts=True) for i, above in others.items()]
    title = f"Costs of the models above that of {models[best].name}"
    return draw_intervals("differences", title, "J above the lowest [%]", rows, zero=True)


def _row(name: str, difference: Difference, css: str, *, starts: bool) -> IntervalRow:
    nan = float("nan")
    low, high = (nan, nan) if difference.low is None or difference.high is None else (difference.low, difference.high)
    return IntervalRow(name, low, high, difference.value, describe_difference(difference), css, starts, not starts)


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
    t, breaks = recording.time_s, np.diff(recording.time_s, prepend=recording.time_s[0]) > TickLimits.MIN_GAP_S
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
