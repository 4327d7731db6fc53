"""The page of a comparison: verdicts, costs, differences, overlaid forces and envelopes, self-contained."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ces_identify.comparison.compared_model import TRAINED
from ces_identify.comparison.comparison import Comparison, ModelResult, join
from ces_identify.comparison.conclusions import best_model, format_signed, headline, p_text
from ces_identify.comparison.overlay_charts import draw_overlay
from ces_identify.comparison.pair_results import Difference, PairResult
from ces_identify.report.interval_chart import IntervalRow, draw_intervals
from ces_identify.report.plot import series_css
from ces_identify.report.shell import command_block, page_template, replace_unencodable
from ces_identify.typesetting import minus
from ces_identify.validation.cost_interval import CostInterval
from ces_identify.validation.envelope_use import UNITS
from ces_observer.json_checks import write_atomically

MAX_OPEN_ROWS = 20  # of a table that is not folded
MAX_DETAILED_PAIRS = 3  # pairs of models up to which the differences on each recording are drawn
NAMES_IN_TITLE = 4


def write_comparison(path: Path, comparison: Comparison, facts: Mapping[str, str]) -> None:
    """Write the page to `path`, as a whole or not at all; raises CesError. `facts` may hold the `command`."""
    write_atomically(path, comparison_page(comparison, facts))


def comparison_page(comparison: Comparison, facts: Mapping[str, str]) -> str:
    """Return the page as HTML that is also well-formed XML."""
    best = best_model(comparison)
    tests = comparison.test_names
    page = page_template("comparison.html.j2", __package__ or "", ("comparison.css",)).render(
        title=_title(comparison),
        headline=headline(comparison),
        warnings=comparison.notes(),
        command=command_block(facts["command"]) if "command" in facts else "",
        facts={key: value for key, value in facts.items() if key != "command"},
        comparison=comparison,
        pooled_over=join(tests) if tests else "",
        rows=[_model_row(comparison, i, best) for i in sorted(range(len(comparison.models)), key=_by_cost(comparison))],
        pairs=[_pair_row(comparison, pair) for pair in comparison.pairs],
        forest=draw_intervals(
            "differences",
            "Differences of cost between the models",
            "J of the first minus J of the second [%]",
            _difference_rows(comparison),
            zero=True,
        )
        if len(comparison.pairs) <= MAX_DETAILED_PAIRS
        else draw_intervals(
            "differences",
            f"Costs of the models above that of {comparison.models[best].name}",
            "J above the lowest [%]",
            _rows_above(comparison, best),
            zero=True,
        ),
        all_pairs=len(comparison.pairs) <= MAX_DETAILED_PAIRS,
        best=comparison.models[best].name,
        same_recordings=len({pair.pooled.recordings for pair in comparison.pairs}) == 1,
        recordings=[
            {
                "recording": comparison.recordings[n],
                "charts": draw_overlay(comparison, n),
                "costs": [m.costs[n] for m in comparison.models],
            }
            for n in comparison.drawn_recordings
        ],
        envelopes=_envelope_charts(comparison),
        fold=MAX_OPEN_ROWS,
        swatches=[_swatch(comparison, i) for i in range(len(comparison.models))],
        notes_on_charts=[note[0].upper() + note[1:] for note in comparison.notes_on_charts()],
        trained=TRAINED,
        interval=interval_text,
        percent=_percent,
    )
    return replace_unencodable(page)


def interval_text(interval: CostInterval | None) -> str:
    """Return an interval of J as text, a dash if there is none."""
    return "–" if interval is None else f"{interval.low:.2f} to {interval.high:.2f}"


def _title(comparison: Comparison) -> str:
    names = [model.name for model in comparison.models]
    models = join(names) if len(names) <= NAMES_IN_TITLE else f"{len(names)} models"
    recordings = [r.name for r in comparison.recordings]
    on = join(recordings) if len(recordings) <= NAMES_IN_TITLE else f"{len(recordings)} recordings"
    return f"{models} on {on}"


def _by_cost(comparison: Comparison) -> Any:
    return lambda i: comparison.models[i].pooled


def _model_row(comparison: Comparison, i: int, best: int) -> dict[str, Any]:
    result, model = comparison.models[i], comparison.models[i].model.model
    above, _, above_interval = ("lowest" if i == best else _above(comparison, best, i)).partition(" (")
    return {
        "name": result.name,
        "source": result.model.source,
        "swatch": _swatch(comparison, i),
        "size": "not a model" if model is None else model.size,
        "rate": "–" if model is None else f"{model.sampling.rate_Hz:g}",
        "cost": _percent(result.pooled),
        "interval": interval_text(result.pooled_interval),
        "above": above,
        "above_interval": above_interval.removesuffix(")"),
        "tick": "–" if result.tick is None else f"{result.tick.median_us:.1f}",
        "bound": _bound(result),
        "outside": _outside(comparison, i),
        "costs": result.costs,
    }


def _bound(result: ModelResult) -> str:
    if result.force_bound_N is not None:
        return f"{result.force_bound_N / 1000:.4g}"
    return "–" if result.model.model is None else "not proved"


def _outside(comparison: Comparison, i: int) -> str:
    if comparison.models[i].model.model is None:
        return "–"
    return (
        f"{100 * max(max((one.outside_share for one in r.exits[i]), default=0.0) for r in comparison.recordings):.1f}"
    )


def _percent(cost: float) -> str:
    return f"{cost:.2f}" if math.isfinite(cost) else "diverged"


def _above(comparison: Comparison, best: int, model: int) -> str:
    """Return how much higher the pooled cost of `model` is than that of the best one, a dash if it is not a test."""
    pair = comparison.pair(best, model)
    if not math.isfinite(pair.pooled.value) or not comparison.test_names:
        return "–"
    return _difference_text(pair.minus(best))


def _pair_row(comparison: Comparison, pair: PairResult) -> dict[str, Any]:
    names = [comparison.models[i].name for i in (pair.first, pair.second)]
    verdict = pair.verdict if pair.better is None else f"{comparison.models[pair.better].name} is better"
    return {
        "pair": f"{names[0]} − {names[1]}",
        "on": join(pair.pooled.recordings),
        "difference": _difference_text(pair.pooled),
        "value": "" if math.isnan(pair.pooled.value) else pair.pooled.value,
        "p_value": "" if pair.p_value is None else pair.p_value,
        "p": p_text(pair.p_value).replace("-", "–"),
        "verdict": verdict,
    }


def _difference_rows(comparison: Comparison) -> list[IntervalRow]:
    """Return a row for each pair and, below it, one for each recording if there are several."""
    rows = []
    for pair in comparison.pairs:
        name = f"{comparison.models[pair.first].name} − {comparison.models[pair.second].name}"
        rows.append(_row(name, pair.pooled, "outline", starts=True))
        for n, one in enumerate(pair.each if len(comparison.recordings) > 1 else ()):
            trained = any(comparison.models[i].costs[n].use == TRAINED for i in (pair.first, pair.second))
            rows.append(_row(f"{one.recordings[0]}{' (no test)' if trained else ''}", one, "envelope", starts=False))
    return rows


def _rows_above(comparison: Comparison, best: int) -> list[IntervalRow]:
    """Return a row for each other model: how much its cost is above the lowest."""
    others = sorted((i for i in range(len(comparison.models)) if i != best), key=_by_cost(comparison))
    return [
        _row(comparison.models[i].name, comparison.pair(best, i).minus(best), _css(comparison, i), starts=True)
        for i in others
    ]


def _row(name: str, one: Difference, css: str, *, starts: bool) -> IntervalRow:
    nan = float("nan")
    low, high = (nan, nan) if one.low is None or one.high is None else (one.low, one.high)
    return IntervalRow(name, low, high, one.value, _difference_text(one), css, starts, not starts)


def _difference_text(one: Difference) -> str:
    if not math.isfinite(one.value):
        return "diverged"
    if one.low is None or one.high is None:
        return f"{format_signed(one.value)} (too short)"
    return f"{format_signed(one.value)} ({format_signed(one.low)} to {format_signed(one.high)})"


def _envelope_charts(comparison: Comparison) -> list[Markup]:
    """Return a chart for each input signal: what each model knows and what each recording holds."""
    return [chart for signal in UNITS if (chart := _envelope_chart(comparison, signal))]


def _envelope_chart(comparison: Comparison, signal: str) -> Markup | None:
    unit, nan = UNITS[signal], float("nan")
    rows = []
    for i, result in enumerate(comparison.models):
        if result.model.model is not None:
            low, high = result.model.model.envelope.by_signal[signal]
            rows.append(IntervalRow(result.name, low, high, nan, _range_text(low, high, unit), _css(comparison, i)))
    if not rows:
        return None
    for n, recording in enumerate(comparison.recordings):
        low, high = recording.ranges[signal]
        rows.append(IntervalRow(recording.name, low, high, nan, _range_text(low, high, unit), "outline", n == 0))
    title = f"{signal.capitalize()}: envelopes of the models, and what the recordings hold"
    return draw_intervals(f"envelope-{signal}", title, f"{signal.capitalize()} [{unit}]", rows)


def _range_text(low: float, high: float, unit: str) -> str:
    return minus(f"{low:.3g} to {high:.3g} {unit}")


def _css(comparison: Comparison, i: int) -> str:
    """Return the class of a model's colour; one that no chart of forces shows has none of its own."""
    return series_css(comparison.drawn.index(i)) if i in comparison.drawn else "outline"


def _swatch(comparison: Comparison, i: int) -> Markup:
    if i not in comparison.drawn:
        return Markup("")
    return Markup(
        '<svg class="plot-swatch" viewBox="0 0 22 10" aria-hidden="true"><path class="{}" d="M1,5h20"/></svg>'
    ).format(_css(comparison, i))
