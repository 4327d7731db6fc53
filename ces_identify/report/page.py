"""From a model and its evaluations to the text of the page: figures drawn, tables filled, template rendered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ces_identify.preparation.weighting import EQUAL, Weighting
from ces_identify.report.correlations import correlation_figure
from ces_identify.report.figures import MAX_DOTS, speed_force, time_plot
from ces_identify.report.grid import make_grid
from ces_identify.report.maps import coverage_map, error_map
from ces_identify.report.shell import format_key, page_template, replace_unencodable
from ces_identify.report.summary import cost_rows, headline, pooled_row, select_role, sort_validation_first, warnings
from ces_identify.report.window import choose_window
from ces_identify.structures import model_table
from ces_identify.validation.error_regions import error_cells, error_regions
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation
from ces_identify.validation.residuals import residual_tests, verdicts
from ces_observer.model import Model

USAGE_RULE = "usage_rule"  # in the provenance: told below the costs
WORST_CELLS = 6  # of the table of where the error sits


def render(
    title: str,
    model: Model,
    evaluations: Sequence[Evaluation],
    facts: Mapping[str, str],
    weighting: Weighting = EQUAL,
) -> str:
    """Return the page as text that is both HTML and well-formed XML."""
    judged = sort_validation_first(evaluations)
    validated = bool(select_role(judged, VALIDATION))
    template = page_template("report.html.j2")
    page = template.render(
        title=title,
        headline=headline(judged),
        validated=validated,
        warnings=warnings(judged),
        facts=facts,
        model=model,
        rows=cost_rows(judged, weighting),
        weighting=str(weighting),
        usage_rule=str(model.provenance.get(USAGE_RULE, "")),
        pooled=pooled_row(select_role(judged, VALIDATION)),
        recordings=[_recording(i, e, model) for i, e in enumerate(judged)],
        most_dots=MAX_DOTS,
        table=model_table(
            model, select_role(judged, VALIDATION) or judged, VALIDATION if validated else IDENTIFICATION
        ),
        maps=_maps(judged, model),
        cells=error_cells(select_role(judged, VALIDATION) or judged)[:WORST_CELLS],
        regions=error_regions(select_role(judged, VALIDATION) or judged),
        settings=_settings(model),
        history={k: v for k, v in model.provenance.items() if not _plain(v)},
    )
    return replace_unencodable(page)


def _recording(number: int, evaluation: Evaluation, model: Model) -> dict[str, Any]:
    window, tests = choose_window(evaluation), residual_tests(evaluation)
    return {
        "correlations": correlation_figure(f"rc{number}", tests, evaluation.name) if tests else None,
        "verdicts": verdicts(tests) if tests else (),
        "window": window,
        "outside": bool(evaluation.run.clamped.any()),
        "speed_force": speed_force(f"sf{number}", evaluation, model),
        "time_plot": time_plot(f"tp{number}", evaluation, window),
        "from_s": evaluation.series.time_s[window.start],
        "to_s": evaluation.series.time_s[window.stop - 1],
    }


def _maps(judged: Sequence[Evaluation], model: Model) -> dict[str, Any] | None:
    """Return the two maps; what is missing of identification and validation is made up for by the other."""
    if not judged:
        return None
    fitted, held_out = select_role(judged, IDENTIFICATION), select_role(judged, VALIDATION)
    grid = make_grid(judged, model.envelope)
    return {
        "one_current": grid.one_current,
        "fitted": bool(fitted),
        "held_out": bool(held_out),
        "coverage": coverage_map("coverage", grid, fitted or held_out, held_out if fitted else [], model),
        "error": error_map("error", grid, held_out or fitted, fitted if held_out else [], model),
    }


def _settings(model: Model) -> dict[str, Any]:
    """Return what the page's last section shows of the model, names made readable."""
    return {
        "Sampling": {format_key(key): value for key, value in asdict(model.sampling).items()},
        "Envelope": {
            **{format_key(key): _span(value) for key, value in asdict(model.envelope).items()},
            format_key("force_N"): _span(model.force_envelope_N),
        },
        "Origin": {
            **{k: v for k, v in model.provenance.items() if _plain(v) and k != USAGE_RULE},
            "model_file_sha256": model.digest(),
        },
    }


def _plain(item: object) -> bool:
    """Return whether an entry of the provenance fits on a line."""
    return not item or not isinstance(item, Mapping | list | tuple)


def _span(value: tuple[float, float]) -> str:
    return f"{value[0]:.4g} to {value[1]:.4g}".replace("-", "\N{MINUS SIGN}")
