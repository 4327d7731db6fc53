"""From a diagnosis to the text of the page: figures drawn, tables filled, template rendered."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

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
    newtons,
    percent,
    percents,
    region_name,
    sentence_case,
)
from ces_gap.report.gap_json import to_plain_json
from ces_gap.report.gap_maps import draw_gap_maps
from ces_gap.report.gap_steps import build_gap_steps, has_correction
from ces_gap.report.share_chart import draw_share_charts
from ces_identify.report.shell import page_template, replace_unencodable

CLEAR_Q, MAX_REGIONS = 0.05, 10  # false-discovery rate and number of the regions shown before and after
VERDICTS = {NAMED: "cause named", AMBIGUOUS: "several causes fit", UNKNOWN: "cause unknown", NO_GAP: "no gap"}
STANDS_OUT = 0.05  # p-value of the test over all regions
EXPERIMENT_FILES = {"next_experiment.yaml": "for ces rig", "next_experiment.csv": "stroke and current for a real rig"}


def report_page(
    diagnosis: Diagnosis,
    title: str = "Simulation and reality",
    facts: Mapping[str, str] | None = None,
    files: Mapping[str, str] | None = None,
) -> str:
    """Return the page as text that is both HTML and well-formed XML.

    `facts` are shown under the verdict as they are: date, command and the like. `files` names what holds the next
    experiment, with what each is for.
    """
    d, gap_there = diagnosis, diagnosis.verdict != NO_GAP
    rows = cause_rows(d) if gap_there else []
    page = page_template("gap.html.j2", __package__, ("gap.css",)).render(
        title=title,
        d=d,
        gap_there=gap_there,
        verdict=VERDICTS[d.verdict],
        facts={"Simulation": d.simulation, **(facts or {})},
        warnings=_warnings(d),
        ladder=build_gap_steps(d),
        hero=_hero(d),
        rows=rows,
        others=effects_without_row(d, rows) if gap_there else [],
        together=composition_rows(d),
        rest_rows=_probabilities(d),
        unsure=_open_questions(d),
        where=_where("where", "gap", d.where) if gap_there else None,
        rest=_where("rest", "rest", d.rest) if d.rest is not None else None,
        plots=_plots(d, join_effect_names(d.composition.effects) if gap_there and d.composition.effects else ""),
        by_region=_by_region(d.by_region) if gap_there else [],
        experiment=_experiment(d.next_experiment, EXPERIMENT_FILES if files is None else files),
        held_out=[_held_out(s) for s in d.held_out],
        learnt=has_correction(d),
    )
    return replace_unencodable(page)


def _hero(d: Diagnosis) -> dict[str, str]:
    """Return the one figure to take away, with what it is."""
    c, of = d.composition, "on recordings the fit never saw"
    if d.verdict == UNKNOWN:
        left = percent(1.0 - c.shrink if c.effects else 1.0)
        most = percent(1.0 - d.ceiling_after_N / d.gap.rms_N if d.gap.rms_N > 0.0 else math.nan)
        text = f"of the gap stays unexplained by the known effects, {of}; a learner without physics explains {most}"
        return {"figure": left, "unit": "%", "text": f"{text}\N{NO-BREAK SPACE}%."}
    if d.verdict == NO_GAP or not c.effects:
        text = f"between simulation and measurement, beside a measurement noise of {newtons(d.gap.noise_floor_N)} N."
        return {"figure": newtons(d.gap.rms_N), "unit": "N", "text": text}
    who = (
        f"{join_effect_names(c.effects)}, the best that fits"
        if d.verdict == AMBIGUOUS
        else join_effect_names(c.effects)
    )
    text = f"of the gap closed by {who}, {of}; 95 % interval {percents(c.shrink_ci95)}."
    return {"figure": percent(c.shrink), "unit": "%", "text": text}


def _probabilities(d: Diagnosis) -> list[tuple[str, str, str, float, str]]:
    """Return what the probabilities of the causes leave: class, label, remark, percent and text."""
    rows = (
        ("outside", "none of these", "an effect outside the library", d.probability_unknown),
        ("nothing", "no effect", "noise and the simulation's own error only", d.probability_none),
    )
    return [(css, label, remark, 100.0 * p, percent(p)) for css, label, remark, p in rows]


def _warnings(d: Diagnosis) -> list[str]:
    out = []
    if d.surrogate_cost_J is not None:
        out.append(
            "Only predictions were given: effects on position and current were tried on a surrogate identified from "
            f"them, whose cost J is {newtons(d.surrogate_cost_J)} % of the predictions."
        )
    return out


def _open_questions(d: Diagnosis) -> list[tuple[str, list[str]]]:
    """Return what these recordings cannot tell, in words: heading and sentences."""
    same = "give the same force on these recordings, to within the noise."
    absorbed = "recalibrating the simulation would look the same. Reference recordings free of the effect part them."
    headed = (
        (
            "Cannot be told apart",
            [f"{sentence_case(join_effect_names(group))} {same}" for group in d.indistinguishable],
        ),
        (
            "Not separable from calibration",
            [f"{sentence_case(join_effect_names(d.not_separable))}: {absorbed}"] * bool(d.not_separable),
        ),
        ("Invisible here", [f"{sentence_case(effect_name(e))}: {reason.rstrip('.')}." for e, reason in d.invisible]),
    )
    return [(heading, said) for heading, said in headed if said]


def _where(ident: str, what: str, where: Where) -> dict[str, Any]:
    """Return a sentence and the figures of where `what` lies."""
    return {
        "sentence": _describe_strongest_region(what, where),
        "strips": draw_share_charts(ident, where.regions),
        "maps": draw_gap_maps(f"{ident}-map", where.maps),
    }


def _describe_strongest_region(what: str, where: Where) -> str:
    r, p = where.strongest, where.max_p_value
    if r is None or not p <= STANDS_OUT:
        return f"No region stands out: the {what} lies wherever the damper works."
    energy, samples = percent(r.share_of_energy), percent(r.share_of_samples)
    return (
        f"The {what} stands out most at {region_name(r)}: {energy} % of its energy in {samples} % of the time "
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
    """Return rows of before and after where the gap is clearly larger than elsewhere, with their bars in percent."""
    regions = [(r, after) for r, after in regions if r.q_value <= CLEAR_Q][:MAX_REGIONS]
    longest = max([max(r.rms_N, after) for r, after in regions] + [1e-9])
    return [
        {
            "region": region_name(r),
            "before": newtons(r.rms_N),
            "after": newtons(after),
            "before_bar": 100.0 * r.rms_N / longest,
            "after_bar": 100.0 * after / longest,
        }
        for r, after in regions
    ]


def _experiment(experiment: NextExperiment | None, files: Mapping[str, str]) -> dict[str, Any] | None:
    if experiment is None:
        return None
    return {
        "name": effect_name(experiment.name),
        "purpose": experiment.purpose,
        "separates": join_effect_names(experiment.separates) if experiment.separates else "",
        "distance": newtons(experiment.distance_N),
        "recipe": to_plain_json(experiment.recipe, "recipe"),
        "plot": experiment_plot("next", experiment),
        "files": files,
    }


def _held_out(series: HeldOutSeries) -> tuple[str, str, str]:
    """Return a recording's name, its usable seconds and its hash."""
    trace = series.trace
    return trace.name, f"{float(trace.usable.sum()) * trace.step_s:.1f}", trace.recording.sha256
