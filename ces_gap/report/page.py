"""From a diagnosis to the text of the page: figures, tables and template."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ces_gap.calibration_map import CalibrationCell, calibration_cells
from ces_gap.diagnosis import (
    AMBIGUOUS,
    NAMED,
    NO_GAP,
    UNKNOWN,
    Diagnosis,
    GapRegion,
    HeldOutSeries,
    NextExperiment,
    Where,
)
from ces_gap.report.before_after import experiment_plot, speed_force, time_plot, worst_second
from ces_gap.report.causes import cause_rows, composition_rows, effects_without_row
from ces_gap.report.formatting import (
    effect_name,
    join_effect_names,
    percent,
    percents,
    region_name,
    sentence_case,
)
from ces_gap.report.gap_json import to_plain_json
from ces_gap.report.gap_maps import draw_gap_maps
from ces_gap.report.gap_steps import build_gap_steps, has_correction
from ces_gap.report.share_chart import draw_share_charts
from ces_gap.trace import SEEN
from ces_identify.report.shell import page_template, replace_unencodable
from ces_identify.typesetting import three_figures

CLEAR_Q, MAX_REGIONS = 0.05, 10  # false-discovery rate and number of the regions in the before-after table
VERDICTS = {NAMED: "cause named", AMBIGUOUS: "several causes fit", UNKNOWN: "cause unknown", NO_GAP: "no gap"}
UNKNOWN_FIGURE = "\N{EN DASH}"
SIGNIFICANT = 0.05  # p-value of the test over all regions
EXPERIMENT_FILES = {
    "next_experiment.yaml": "recipe for ces rig",
    "next_experiment.csv": "stroke and current for a real rig",
}


def report_page(
    diagnosis: Diagnosis, title: str = "Simulation and reality", facts: Mapping[str, str] | None = None
) -> str:
    """Return the page as text that is both HTML and well-formed XML; `facts` (date, command) follow the verdict."""
    d, has_gap = diagnosis, diagnosis.verdict != NO_GAP
    rows = cause_rows(d) if has_gap else []
    page = page_template("gap.html.j2", __package__, ("gap.css",)).render(
        title=title,
        d=d,
        has_gap=has_gap,
        verdict=VERDICTS[d.verdict],
        facts={"Simulation": d.simulation, **(facts or {})},
        warnings=_warnings(d),
        gap_steps=build_gap_steps(d),
        key_figure=_key_figure(d),
        rows=rows,
        unknown_figures=any(UNKNOWN_FIGURE in (r.gap_after, r.shrink, r.interval, r.probability) for r in rows),
        others=effects_without_row(d, rows) if has_gap else [],
        together=composition_rows(d),
        rest_rows=_probabilities(d),
        calibration=_calibration_table(d) if has_gap else None,
        refits=_refits(d),
        open_questions=_open_questions(d),
        where=_where("where", "gap", d.where) if has_gap else None,
        rest=_where("rest", "rest", d.rest) if d.rest is not None else None,
        plots=_plots(d, join_effect_names(d.composition.effects) if has_gap and d.composition.effects else ""),
        by_region=_by_region(d.by_region) if has_gap else [],
        experiment=_experiment(d.next_experiment),
        held_out=[_held_out(s) for s in d.held_out],
        has_correction=has_correction(d),
    )
    return replace_unencodable(page)


def _key_figure(d: Diagnosis) -> dict[str, str]:
    """Return the most important figure with its unit and an explanation."""
    c = d.composition
    if d.verdict == UNKNOWN:
        left = percent(1.0 - c.shrink if c.effects else 1.0)
        text = "of the gap on held-out recordings remains unexplained by known effects; a generic learner explains"
        if c.effects and c.shrink < 0.0:
            text = "of the gap is there on held-out recordings with what was fitted, so the fit does not carry over; a "
            text += "generic learner explains"
        return {"figure": left, "unit": "%", "text": f"{text} {_learner_share(d)}."}
    if d.verdict == NO_GAP or not c.effects:
        text = f"between simulation and measurement; the measurement noise is {three_figures(d.gap.noise_floor_N)} N."
        return {"figure": three_figures(d.gap.rms_N), "unit": "N", "text": text}
    names = join_effect_names(c.effects) + (" (best fit)" if d.verdict == AMBIGUOUS else "")
    interval = f"95\N{NO-BREAK SPACE}% interval {percents(c.shrink_ci95)}"
    text = f"of the gap on held-out recordings closed by {names}; {interval}."
    return {"figure": percent(c.shrink), "unit": "%", "text": text}


def _learner_share(d: Diagnosis) -> str:
    """Return the share of the gap that a generic learner explains, which may make it worse on held-out recordings."""
    share = 1.0 - d.ceiling_after_N / d.gap.rms_N if d.gap.rms_N > 0.0 else math.nan
    return "nothing of it" if share <= 0.0 else f"{percent(share)}\N{NO-BREAK SPACE}%"


def _calibration_table(d: Diagnosis) -> dict[str, Any] | None:
    """Return the map of a calibration [N]: ranges of current as columns, of speed as rows."""
    cells = calibration_cells(d)
    currents = list(dict.fromkeys(c.current_A for c in cells))
    by_speed = {speed: {c.current_A: c.force_N for c in cells if c.speed_m_s == speed} for speed in _speeds(cells)}
    rows = [
        (f"{low:.2f} to {high:.2f}", [f"{forces[i]:+.1f}" if i in forces else "" for i in currents])
        for (low, high), forces in by_speed.items()
    ]
    return {"currents": [f"{low:.2f} to {high:.2f}" for low, high in currents], "rows": rows} if cells else None


def _speeds(cells: Sequence[CalibrationCell]) -> list[tuple[float, float]]:
    return list(dict.fromkeys(c.speed_m_s for c in cells))


def _probabilities(d: Diagnosis) -> list[tuple[str, str, str, float, str]]:
    """Return the rows of the remaining probabilities: class, label, remark, percent and text."""
    rows = (
        ("outside", "none of these", "an effect outside the library", d.probability_unknown),
        ("nothing", "no effect", "only noise and baseline error", d.probability_none),
    )
    return [(css, label, remark, 100.0 * p, percent(p)) for css, label, remark, p in rows]


def _refits(d: Diagnosis) -> list[dict[str, str]]:
    """Return the refits of a physical model's parameters that close part of the gap."""
    refits = d.witness.refits if d.witness is not None else ()
    return [
        {
            "group": sentence_case(refit.group),
            "changes": "; ".join(
                f"{c.name}: {three_figures(c.before)} to {three_figures(c.after)}" for c in refit.changes
            ),
            "moved": f"{refit.moved_z:.1f}",
            "control": "–" if refit.control_z is None else f"{refit.control_z:.1f}",
            "closes": percent(refit.closes),
        }
        for refit in refits
        if refit.energy > refit.energy_error
    ]


def _warnings(d: Diagnosis) -> list[str]:
    """Return what a reader must know before the result; the other notes are at the end of the page."""
    seen = [f"{sentence_case(note)}." for note in d.notes if SEEN in note]
    if d.surrogate_cost_J is None:
        return seen
    return [
        *seen,
        "The simulation is available only as recorded predictions. Effects on position and current were evaluated with "
        f"a surrogate learned from these predictions; its cost J is {three_figures(d.surrogate_cost_J)} %."
        + (
            ""
            if d.surrogate_error is None
            else f" Its error where inputs change is about {percent(d.surrogate_error)} % of the change."
        ),
    ]


def _open_questions(d: Diagnosis) -> list[tuple[str, list[str]]]:
    """Return headings and sentences about what these recordings leave open."""
    same = "give the same force on these recordings, within the noise."
    absorbed = "a recalibration of the simulation would have the same effect. Record references to separate the two."
    alike = [f"{sentence_case(join_effect_names(group))} {same}" for group in d.indistinguishable]
    static = [f"{sentence_case(join_effect_names(d.not_separable))}: {absorbed}"] * bool(d.not_separable)
    invisible = [f"{sentence_case(effect_name(e))}: {reason.rstrip('.')}." for e, reason in d.invisible]
    questions = (
        ("Indistinguishable effects", alike),
        ("Not separable from calibration", static),
        ("Not visible in these recordings", invisible),
    )
    return [(heading, sentences) for heading, sentences in questions if sentences]


def _where(ident: str, what: str, where: Where) -> dict[str, Any]:
    """Return the sentence and the figures that locate `what`."""
    return {
        "sentence": _describe_strongest_region(what, where),
        "share_charts": draw_share_charts(ident, where.regions),
        "maps": draw_gap_maps(f"{ident}-map", where.maps),
    }


def _describe_strongest_region(what: str, where: Where) -> str:
    r, p = where.strongest, where.max_p_value
    if r is None or not p <= SIGNIFICANT:
        return f"No region stands out: the {what} is spread over the whole operating range."
    energy, samples = percent(r.share_of_energy), percent(r.share_of_samples)
    return (
        f"The {what} is most concentrated at {region_name(r)}: {energy} % of its energy in {samples} % of the time "
        f"(p = {p:.2g} over all regions)."
    )


def _plots(d: Diagnosis, effects: str) -> dict[str, Any] | None:
    worst = worst_second(d.held_out)
    if worst is None:
        return None
    trace = worst.series.trace
    return {
        "speed_force": speed_force("sf", d.held_out, effects),
        "time": time_plot("worst", worst, effects),
        "name": trace.name,
        "from_s": float(trace.time_s[worst.start]),
        "to_s": float(trace.time_s[worst.stop - 1]),
    }


def _by_region(regions: Sequence[tuple[GapRegion, float]]) -> list[dict[str, Any]]:
    """Return the gap before and after, with bars [%], in regions where it is significantly larger than elsewhere."""
    regions = [(r, after) for r, after in regions if r.q_value <= CLEAR_Q][:MAX_REGIONS]
    longest = max([max(r.rms_N, after) for r, after in regions] + [1e-9])
    return [
        {
            "region": region_name(r),
            "before": three_figures(r.rms_N),
            "after": three_figures(after),
            "before_bar": 100.0 * r.rms_N / longest,
            "after_bar": 100.0 * after / longest,
        }
        for r, after in regions
    ]


def _experiment(experiment: NextExperiment | None) -> dict[str, Any] | None:
    if experiment is None:
        return None
    return {
        "name": effect_name(experiment.name),
        "purpose": experiment.purpose,
        "separates": join_effect_names(experiment.separates) if experiment.separates else "",
        "distance": three_figures(experiment.distance_N),
        "recipe": to_plain_json(experiment.recipe, "recipe"),
        "plot": experiment_plot("next", experiment),
        "files": EXPERIMENT_FILES,
    }


def _held_out(series: HeldOutSeries) -> tuple[str, str, str]:
    """Return a recording's name, its usable seconds and its hash."""
    trace = series.trace
    return trace.name, f"{float(trace.usable.sum()) * trace.step_s:.1f}", trace.recording.sha256
