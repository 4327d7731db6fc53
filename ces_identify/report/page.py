"""The page about a model and its evaluations: headline, warnings, tables, figures and the rendered template."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ces_identify.physical.quantities import ERRORS
from ces_identify.prepare.cost import EQUAL, Weighting
from ces_identify.prepare.sampling import delay_text
from ces_identify.report.figures import (
    MAX_DOTS,
    choose_window,
    correlation_figure,
    count_lines,
    coverage_map,
    error_map,
    make_grid,
    speed_force,
    time_plot,
)
from ces_identify.report.steady import steady_section
from ces_identify.report.summary import NEGATIVE, draw_picture, summarize_model
from ces_identify.structures import model_section
from ces_identify.structures.auto import REASON
from ces_identify.structures.kit import UNDETERMINED
from ces_identify.structures.polynomial import COSTS_BY_TERMS, size_sections
from ces_identify.validation.cost_table import COSTS, cost_table, interval_text, percent
from ces_identify.validation.evaluate import (
    IDENTIFICATION,
    VALIDATION,
    Evaluation,
    describe_size,
    explain_missing,
    pool_evaluations,
)
from ces_identify.validation.lacks import head_lines
from ces_identify.validation.residuals import residual_tests, verdicts
from ces_observer.json_text import write_atomically
from ces_observer.model import Model
from ces_report.plot import draw_section, share_points
from ces_report.shell import PageHead, format_key, page_template, replace_unencodable
from ces_report.table import Table, text_table
from ces_report.typesetting import join_names, minus, three_figures

ROLES = (VALIDATION, IDENTIFICATION)
MAX_WARNED = 3  # recordings outside the envelope that have a warning each
USAGE_RULE = "usage_rule"  # key in the provenance; shown below the costs
LISTED = (COSTS, IDENTIFICATION, VALIDATION, "usage")  # keys of the provenance; tables show them
HASH_DIGITS = 16
SHOWN_ABOVE = (COSTS_BY_TERMS, ERRORS, UNDETERMINED, "structure", "structures", REASON)  # of the selection
MAX_DRAWN = 10  # recordings with charts, so that the page stays below 3 MB
NO_CERTIFICATE = (
    "None: this model comes without a proof of stability. The observer tries one itself; if that fails, it refuses the "
    "model unless allow_uncertified is true."
)


def write_report(
    path: Path,
    head: PageHead,
    model: Model,
    evaluations: Sequence[Evaluation],
    facts: Mapping[str, str] | None = None,
    weighting: Weighting = EQUAL,
) -> None:
    """Write the page about `model` and its `evaluations`, HTML that is also well-formed XML, to `path`.

    `facts` are shown with the provenance. A `weighting` adds the weighted J of each
    recording. Raises CesError if `path` cannot be written; an existing file then stays unchanged.
    """
    ordered = sorted(evaluations, key=lambda e: e.role != VALIDATION)
    held_out = [e for e in ordered if e.role == VALIDATION]
    drawn = sorted(sorted(range(len(ordered)), key=lambda i: -ordered[i].cost)[:MAX_DRAWN])
    points = share_points(sum(count_lines(ordered[i]) for i in drawn), len(drawn))
    selection = model.provenance.get("selection", {})
    structures = selection.get("structures") or {}
    kind = model.structure.replace("_", " ").replace("narx", "NARX").replace("anfis", "ANFIS")
    page = page_template("report.html.j2", "ces_identify.report").render(
        head=head,
        subject=_describe_recordings(ordered),
        lacks=[NEGATIVE.sub("\N{MINUS SIGN}", line) for line in head_lines(model, ordered)],
        answers=summarize_model(model, ordered, _format_headline(ordered, held_out, model), head.command),
        picture=_draw_first(ordered),
        warnings=_format_warnings(ordered),
        facts={
            "Model": f"{kind}, {describe_size(model)}, {model.sampling.rate_Hz:g} Hz",
            "Identified by": str(model.provenance.get("tool", "")) or "not known",
            **(facts or {}),
        },
        model=model,
        costs=cost_table(
            ordered,
            weighting=weighting,
            anchors={(ordered[i].name, ordered[i].role): f"recording-{i}" for i in reversed(drawn)},
        ),
        weighting=str(weighting),
        usage_rule=str(model.provenance.get(USAGE_RULE, "")),
        missing=[f"{line[0].upper()}{line[1:]}." for line in explain_missing(ordered)],
        pooled=pool_evaluations(held_out) if all(math.isfinite(e.cost) for e in held_out) else None,
        interval=interval_text,
        percent=percent,
        bad=lambda e: "" if math.isfinite(e.cost) else "bad",
        structures=text_table(
            ("Structure", "J on data left out [%]"), [(name, three_figures(cost)) for name, cost in structures.items()]
        ),
        reason=selection.get(REASON, ""),
        **_draw_model(model, ordered, drawn, points),
        drawn=drawn,
        most_dots=MAX_DOTS,
        sources=_list_sources(model),
        settings=_settings(model),
        history=_history(model),
    )
    write_atomically(path, replace_unencodable(page))


def _draw_first(ordered: Sequence[Evaluation]) -> Markup:
    """Return a picture of the first recording with the highest cost, of validation if there is one."""
    finite = [e for e in ordered if math.isfinite(e.cost)]
    worst = max(finite, key=lambda e: (e.role == VALIDATION, e.cost), default=None)
    return Markup() if worst is None else draw_picture(worst, choose_window(worst))


def _draw_model(model: Model, ordered: Sequence[Evaluation], drawn: Sequence[int], points: int) -> dict[str, Any]:
    """Return the recordings, the model's table with its charts, and the maps."""
    held_out = [e for e in ordered if e.role == VALIDATION]
    section = model_section(model, held_out or ordered, VALIDATION if held_out else IDENTIFICATION)
    first = [steady_section(model, ordered)] if ordered else []
    return {
        "recordings": [_draw_recording(i, ordered[i], model, points) for i in drawn],
        "first_sections": [(one, draw_section(one)) for one in first],
        "model_sections": [(one, draw_section(one)) for one in (section, *size_sections(model))],
        "maps": _draw_maps(ordered, model),
    }


def _describe_recordings(evaluations: Sequence[Evaluation]) -> str:
    """Return the recordings of the report in a phrase, such as `road (validation); noise, sweep (identification)`."""
    named = ((role, join_names(list(dict.fromkeys(e.name for e in evaluations if e.role == role)))) for role in ROLES)
    return "; ".join(f"{names} ({role})" for role, names in named if names)


def _format_headline(evaluations: Sequence[Evaluation], held_out: Sequence[Evaluation], model: Model) -> str:
    """Return one sentence about the costs of the evaluations `held_out`, else of all."""
    delay_s = model.sampling.delay_s
    costs = f"{f', {delay_text(delay_s)}' if delay_s else ''}: {_describe_costs(held_out or evaluations)}"
    if held_out:
        return f"Validation{costs}."
    if not evaluations:
        return "Not validated, and not run on any recording."
    return f"Not validated: fit and selection used all recordings below. On these{costs}."


def _describe_costs(evaluations: Sequence[Evaluation]) -> str:
    """Return the lowest and the highest cost in a phrase."""
    finite = sorted((e for e in evaluations if math.isfinite(e.cost)), key=lambda e: e.cost)
    lost = len(evaluations) - len(finite)
    if not finite:
        return f"the free run diverged on every recording ({lost})"
    best, worst = (f"{three_figures(e.cost)} % ({e.name})" for e in (finite[0], finite[-1]))
    costs = f"cost J = {best}" if len(finite) == 1 else f"cost J from {best} to {worst}, {len(finite)} recordings"
    return costs + (f"; the free run diverged on {lost} more" if lost else "")


def _format_warnings(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return the warnings of evaluations: no force, held at its envelope, outside the band; inputs outside theirs.

    Of more than MAX_WARNED recordings outside, the worst stands for all.
    """
    held = sorted((e for e in evaluations if e.held_text), key=lambda e: -e.held_share)
    others = [(e.lost_text, e.role) for e in evaluations if e.lost_text][:MAX_WARNED]
    others += [(e.late_text, e.role) for e in evaluations if e.late_text][:MAX_WARNED]
    others += [(e.held_text, e.role) for e in held[:MAX_WARNED]]
    others += [(e.band_text, e.role) for e in evaluations if e.band_text][:MAX_WARNED]
    texts = [minus(f"{text} ({role}).") for text, role in others]
    outside = [e for e in evaluations if e.outside]
    if len(outside) <= MAX_WARNED:
        return texts + [minus(f"{e.outside_text} ({e.role}).") for e in outside]
    many = f"{len(outside)} of {len(evaluations)} recordings are outside the model's envelope; most of all"
    return [*texts, minus(f"{many} {max(outside, key=lambda e: e.clamped_share).outside_text}.")]


def _draw_recording(number: int, evaluation: Evaluation, model: Model, max_points: int) -> dict[str, Any]:
    window, tests = choose_window(evaluation), residual_tests(evaluation)
    return {
        "number": number,
        "evaluation": evaluation,
        "cost": percent(evaluation.cost, evaluation.interval),
        "correlations": correlation_figure(f"rc{number}", tests, evaluation.name) if tests else None,
        "verdicts": verdicts(tests) if tests else (),
        "window": window,
        "outside": bool(evaluation.run.clamped.any()),
        "speed_force": speed_force(f"sf{number}", evaluation, model),
        "time_plot": time_plot(f"tp{number}", evaluation, window, max_points),
        "from_s": evaluation.series.time_s[window.start],
        "to_s": evaluation.series.time_s[window.stop - 1],
    }


def _draw_maps(evaluations: Sequence[Evaluation], model: Model) -> dict[str, Any] | None:
    """Return the two maps; if identification or validation is missing, the other replaces it."""
    if not evaluations:
        return None
    held_out, fitted = ([e for e in evaluations if e.role == role] for role in ROLES)
    grid = make_grid(evaluations, model.envelope)
    return {
        "fitted": bool(fitted),
        "held_out": bool(held_out),
        "coverage": coverage_map("coverage", grid, fitted or held_out, held_out if fitted else [], model),
        "error": error_map("error", grid, held_out or fitted, fitted if held_out else [], model),
    }


def _settings(model: Model) -> dict[str, Any]:
    """Return the model's settings for the page's last section, with readable names."""
    ends = {**asdict(model.envelope), "estimates_held_within_N": model.force_envelope_N}
    return {
        "Sampling": {format_key(key): value for key, value in asdict(model.sampling).items()},
        "Envelope of the inputs": {
            format_key(key): minus("{:.4g} to {:.4g}".format(*range_)) for key, range_ in ends.items() if range_
        },
        "Stability certificate": model.certificate or NO_CERTIFICATE,
        "Origin": {
            **{k: v for k, v in model.provenance.items() if _fits_on_line(v) and k != USAGE_RULE},
            "model_file_sha256": model.digest(),
        },
    }


def _list_sources(model: Model) -> Table[Sequence[str]]:
    """Return the recordings in a model's provenance: what they were used for, their day and the hash of their bytes."""

    def row(role: str, one: Mapping[str, Any]) -> tuple[str, ...]:
        first, last = one.get("share") or (0.0, 1.0)
        part = "" if last - first >= 1.0 else f", {100.0 * first:.0f} to {100.0 * last:.0f} %"
        return str(one["recording"]), f"{role}{part}", str(one.get("day", "")), str(one.get("sha256", ""))[:HASH_DIGITS]

    rows = [row(role, one) for role in (IDENTIFICATION, VALIDATION) for one in model.provenance.get(role, ())]
    return text_table(("Recording", "Used for", "Recorded", "sha256"), rows, left=4)


def _history(model: Model) -> dict[str, Any]:
    """Return the longer entries of the provenance, without those shown in sections of their own."""
    longer = {key: v for key, v in model.provenance.items() if key not in LISTED and not _fits_on_line(v)}
    shown = {key: value for key, value in longer.pop("selection", {}).items() if key not in SHOWN_ABOVE}
    return longer | ({"selection": shown} if shown else {})


def _fits_on_line(item: object) -> bool:
    """Return whether an entry of the provenance fits on one line."""
    return not item or not isinstance(item, Mapping | list | tuple)
