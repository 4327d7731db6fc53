"""The text of the page from a model and its evaluations: figures, tables and the rendered template."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ces_identify.preparation.weighting import EQUAL, Weighting
from ces_identify.report.charts import SIZES, draw_chart
from ces_identify.report.correlations import correlation_figure
from ces_identify.report.figures import MAX_DOTS, count_lines, speed_force, time_plot
from ces_identify.report.grid import make_grid
from ces_identify.report.maps import coverage_map, error_map
from ces_identify.report.plot import share_points
from ces_identify.report.shell import format_key, page_template, replace_unencodable
from ces_identify.report.summary import (
    cost_rows,
    describe_recordings,
    headline,
    missing_figures,
    outside_rows,
    pooled_row,
    select_role,
    structure_advice,
    structure_rows,
    warnings,
)
from ces_identify.report.window import choose_window
from ces_identify.structures import model_table
from ces_identify.structures.physical_quantities import ERRORS
from ces_identify.typesetting import minus
from ces_identify.validation.band_coverage import coverage_regions
from ces_identify.validation.error_regions import error_cells, error_regions
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation
from ces_identify.validation.residuals import residual_tests, verdicts
from ces_observer.json_checks import write_atomically
from ces_observer.model import Model

USAGE_RULE = "usage_rule"  # key in the provenance; shown below the costs
MARKS = "marks"  # key of the hashes in the provenance by which copies and parts of recordings are recognised
SHOWN_ABOVE = (ERRORS, "structure", "structures")  # of the provenance's selection
MAX_DRAWN = 10  # recordings with charts, so that the page stays below 3 MB
WORST_CELLS = 6  # rows in the table of errors


def write_report(
    path: Path,
    title: str,
    model: Model,
    evaluations: Sequence[Evaluation],
    facts: Mapping[str, str],
    weighting: Weighting = EQUAL,
) -> None:
    """Write the page about `model` and its `evaluations`, HTML that is also well-formed XML, to `path`.

    `facts` appear under the title: date, command, noise floor and the like. A `weighting` adds the weighted J of each
    recording. Raises CesError if `path` cannot be written; an existing file then stays unchanged.
    """
    ordered = sorted(evaluations, key=lambda e: e.role != VALIDATION)
    held_out = select_role(ordered, VALIDATION)
    shown = held_out or ordered
    drawn = _find_drawn(ordered)
    points = share_points(sum(count_lines(ordered[i]) for i in drawn), len(drawn))
    table = model_table(model, shown, VALIDATION if held_out else IDENTIFICATION)
    page = page_template("report.html.j2").render(
        title=title,
        subject=describe_recordings(ordered),
        headline=headline(ordered),
        warnings=warnings(ordered),
        facts={"Model": _describe_model(model), **facts},
        model=model,
        rows=cost_rows(ordered, weighting),
        weighting=str(weighting),
        usage_rule=str(model.provenance.get(USAGE_RULE, "")),
        missing=missing_figures(ordered),
        outside=outside_rows(ordered),
        pooled=pooled_row(held_out),
        structures=structure_rows(model),
        advice=structure_advice(model),
        recordings=[_recording(i, ordered[i], model, points) for i in drawn],
        drawn=drawn,
        most_dots=MAX_DOTS,
        table=table,
        charts=[
            (draw_chart(f"chart{n}", chart, size), chart.caption)
            for n, (chart, size) in enumerate(zip(table.charts, SIZES, strict=False))
        ],
        maps=_maps(ordered, model),
        cells=error_cells(shown)[:WORST_CELLS],
        regions=error_regions(shown),
        coverage=coverage_regions(shown),
        settings=_settings(model),
        history=_history(model),
    )
    write_atomically(path, replace_unencodable(page))


def _find_drawn(evaluations: Sequence[Evaluation]) -> list[int]:
    """Return the numbers of the recordings with charts: of many, those with the highest costs."""
    worst = sorted(range(len(evaluations)), key=lambda i: -evaluations[i].cost)[:MAX_DRAWN]
    return sorted(worst)


def _describe_model(model: Model) -> str:
    kind = model.structure.replace("_", " ").replace("narx", "NARX").replace("anfis", "ANFIS")
    return f"{kind}, {model.size}, {model.sampling.rate_Hz:g} Hz"


def _recording(number: int, evaluation: Evaluation, model: Model, max_points: int) -> dict[str, Any]:
    window, tests = choose_window(evaluation), residual_tests(evaluation)
    return {
        "number": number,
        "correlations": correlation_figure(f"rc{number}", tests, evaluation.name) if tests else None,
        "verdicts": verdicts(tests) if tests else (),
        "window": window,
        "outside": bool(evaluation.run.clamped.any()),
        "speed_force": speed_force(f"sf{number}", evaluation, model),
        "time_plot": time_plot(f"tp{number}", evaluation, window, max_points),
        "from_s": evaluation.series.time_s[window.start],
        "to_s": evaluation.series.time_s[window.stop - 1],
    }


def _maps(evaluations: Sequence[Evaluation], model: Model) -> dict[str, Any] | None:
    """Return the two maps; if identification or validation is missing, the other replaces it."""
    if not evaluations:
        return None
    fitted, held_out = select_role(evaluations, IDENTIFICATION), select_role(evaluations, VALIDATION)
    grid = make_grid(evaluations, model.envelope)
    return {
        "one_current": grid.one_current,
        "fitted": bool(fitted),
        "held_out": bool(held_out),
        "coverage": coverage_map("coverage", grid, fitted or held_out, held_out if fitted else [], model),
        "error": error_map("error", grid, held_out or fitted, fitted if held_out else [], model),
    }


def _settings(model: Model) -> dict[str, Any]:
    """Return the model's settings for the page's last section, with readable names."""
    return {
        "Sampling": {format_key(key): value for key, value in asdict(model.sampling).items()},
        "Envelope": {
            **{format_key(key): _format_range(value) for key, value in asdict(model.envelope).items()},
            format_key("force_N"): _format_range(model.force_envelope_N),
        },
        "Origin": {
            **{k: v for k, v in model.provenance.items() if _fits_on_line(v) and k != USAGE_RULE},
            "model_file_sha256": model.digest(),
        },
    }


def _history(model: Model) -> dict[str, Any]:
    """Return the longer entries of the provenance, without those shown in sections of their own."""
    longer = {key: _without_marks(value) for key, value in model.provenance.items() if not _fits_on_line(value)}
    shown = {key: value for key, value in longer.pop("selection", {}).items() if key not in SHOWN_ABOVE}
    return longer | ({"selection": shown} if shown else {})


def _without_marks(entry: Any) -> Any:
    """Return an entry of the provenance without the marks of its recordings, which say nothing to a reader."""
    if isinstance(entry, Mapping):
        return {key: _without_marks(value) for key, value in entry.items() if key != MARKS}
    return [_without_marks(value) for value in entry] if isinstance(entry, list | tuple) else entry


def _fits_on_line(item: object) -> bool:
    """Return whether an entry of the provenance fits on one line."""
    return not item or not isinstance(item, Mapping | list | tuple)


def _format_range(value: tuple[float, float]) -> str:
    return minus(f"{value[0]:.4g} to {value[1]:.4g}")
