"""From a diagnosis to the text of the page: figures, tables and template."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ces_gap.diagnosis import (
    AMBIGUOUS,
    NAMED,
    NO_GAP,
    UNKNOWN,
    Diagnosis,
    Explanation,
    Explanations,
    Interval,
    NextExperiment,
    Where,
    find_best_other,
    find_closest,
)
from ces_gap.inference.judgement import PARAMETERS
from ces_gap.limits import EvidenceLimits, RegionLimits
from ces_gap.report.charts import (
    draw_gap_maps,
    draw_share_charts,
    experiment_plot,
    find_largest_errors,
    speed_force,
    time_plot,
)
from ces_gap.report.formatting import effect_name, join_effect_names, percent, percents, region_name, sentence_case
from ces_gap.report.gap_json import to_plain_json
from ces_gap.report.sentences import describe_correction
from ces_gap.report.tables import (
    CauseRow,
    calibration_table,
    cause_notes,
    cause_table,
    composition_table,
    describe_explanation,
    explained_table,
    probe_table,
    recording_table,
    region_table,
)
from ces_report.shell import PageHead, page_template, replace_unencodable
from ces_report.table import Table, summarize_result
from ces_report.typesetting import format_within, three_figures

VERDICTS = {NAMED: "cause named", AMBIGUOUS: "several causes fit", UNKNOWN: "cause unknown", NO_GAP: "no gap"}
STEP_ROOM = 1.04  # of the longest bar or interval
MAX_CONTROL = 2.0  # of the longest gap: a longer bar of a control is cut off and marked
SAME = 1e-9  # relative difference below which the references had no influence
EXPERIMENT_FILES = {
    "next_experiment.yaml": "recipe for ces rig",
    "next_experiment.csv": "stroke and current for a real rig",
}


@dataclass(frozen=True)
class Bar:
    """A bar: label, remark, figures as text, and its length and whisker (start, length) in percent."""

    css: str
    label: str
    remark: str
    value: str
    interval: str
    length: float
    whisker: tuple[float, float] | None


@dataclass(frozen=True)
class GapSteps:
    """The steps from the original to the augmented simulation, the controls, and the noise [%] on their scale.

    `cut` says that a bar is longer than shown.
    """

    steps: tuple[Bar, ...]
    controls: tuple[Bar, ...]
    noise: float
    cut: bool


def report_page(diagnosis: Diagnosis, head: PageHead | None = None) -> str:
    """Return the page as text that is both HTML and well-formed XML."""
    d, has_gap = diagnosis, diagnosis.verdict != NO_GAP
    causes, where = cause_table(d), _where("where", "gap", d.where) if has_gap else None
    page = page_template("gap.html.j2", __package__, ("gap.css",)).render(
        head=(head or PageHead()).titled("Simulation and reality"),
        d=d,
        has_gap=has_gap,
        verdict=VERDICTS[d.verdict],
        first=({"Where": where["sentence"]} if where else {}) | {"Next": _next_step(d)},
        facts={"Simulation": d.simulation},
        warnings=_warnings(d),
        gap_steps=build_gap_steps(d),
        key_figure=_key_figure(d),
        causes=causes,
        row_css=lambda row: row.css,
        cause_notes=cause_notes(d),
        together=composition_table(d),
        calibration=calibration_table(d) if has_gap else None,
        open_questions=_open_questions(d),
        where=where,
        rest=_where("rest", "rest", d.rest) if d.rest is not None else None,
        plots=_plots(d, join_effect_names(d.composition.effects) if has_gap and d.composition.effects else ""),
        by_region=region_table(d) if has_gap else None,
        experiment=_experiment(d.next_experiment),
        held_out=recording_table(d),
        has_correction=has_correction(d),
        probed=probe_table(d),
    )
    return replace_unencodable(page)


@summarize_result.register
def _(diagnosis: Diagnosis) -> tuple[Sequence[str], Table[CauseRow]]:
    gap = diagnosis.gap
    rms, interval = format_within(gap.rms_N, *gap.ci95_N)
    size = f"Gap {rms} N RMS ({interval}) on held-out recordings, J {three_figures(gap.cost_J)} %."
    step = _next_step(diagnosis, ' (written by out="FOLDER"; ces.simulate runs it)')
    return [diagnosis.sentence, size, f"Next: {step}", *cause_notes(diagnosis)], cause_table(diagnosis)


@summarize_result.register
def _(explanations: Explanations) -> tuple[Sequence[str], Table[CauseRow]]:
    return ["each effect in its best form" if explanations else "no effect"], explained_table(explanations)


@summarize_result.register
def _(explanation: Explanation) -> tuple[Sequence[str], Table[CauseRow]]:
    table = explained_table([explanation] if explanation.effects else [])
    return describe_explanation(explanation) or ["no effect"], table


@summarize_result.register
def _(experiment: NextExperiment) -> tuple[Sequence[str], Table[Any]]:
    time, x, current = experiment.time_s, 1e3 * experiment.position_m, experiment.current_A
    distance = f" by {three_figures(experiment.distance_N)} N RMS"
    return [
        f"{effect_name(experiment.name)}: {experiment.purpose}",
        *([f"separates {join_effect_names(experiment.separates)}{distance}"] if experiment.separates else []),
        f"{np.ptp(time):.3g} s, {x.min():.3g} to {x.max():.3g} mm, {current.min():.3g} to {current.max():.3g} A",
    ], Table((), ())


def build_gap_steps(d: Diagnosis) -> GapSteps:
    """Return the bars of a diagnosis: RMS [N] on held-out recordings, without noise except in the noise's own bar."""
    gap, c, ceiling = d.gap, d.composition, d.ceiling_after_N
    if d.verdict == UNKNOWN:  # one explanation is the closest, in the sentence and in every bar
        c = find_closest(d) or c
    ends = [gap.rms_N, gap.ci95_N[1], gap.corrected_N, gap.corrected_ci95_N[1], gap.noise_floor_N]
    longest = max([v for v in ends if math.isfinite(v)] + [1e-9])
    wrong = find_best_other(d, c)
    others = [c.gap_after_N, ceiling] + ([] if wrong is None else [wrong.gap_after_N])
    scale = STEP_ROOM * min(max([longest, *filter(math.isfinite, others)]), MAX_CONTROL * longest)
    steps = [_bar(scale, "before", "Original simulation", "", gap.rms_N, gap.ci95_N)]
    if has_correction(d):
        done = ["timing of the inputs corrected"] * bool(d.probe.corrected)
        done += ["learned from the reference recordings"] * (d.correction is not None)
        taken = 1.0 - gap.corrected_N / gap.rms_N if gap.rms_N > 0.0 else math.nan
        closes = f"closes {percent(taken)} %" if taken > 0.0 else ""
        remark = ": ".join(filter(None, [" and ".join(done), closes]))
        label = f"With {effect_name(PARAMETERS)}" if d.is_recalibrated else "Baseline error removed"
        steps.append(_bar(scale, "corrected", label, remark, gap.corrected_N, gap.corrected_ci95_N))
    if {*c.effects} - {PARAMETERS}:
        shrink = 1.0 - c.gap_after_N / gap.corrected_N if gap.corrected_N > 0.0 else 0.0
        closes = f"closes {percent(shrink)} % of the bar above" if shrink > 0.0 else ""
        remark = "the closest of the known effects" if d.verdict == UNKNOWN else closes
        text = f"With {join_effect_names(c.effects)}"
        steps.append(_bar(scale, "after", text, remark, c.gap_after_N, after_ci95_N(d, c)))
    remark = f"as logged, from {gap.noise_source}, {gap.noise_in_band}subtracted from all other bars"
    steps.append(_bar(scale, "noise", "Measurement noise", remark, gap.noise_floor_N, None))
    controls = []
    if wrong is not None:
        text = f"Best {'other ' if c.effects else ''}effect: {effect_name(wrong.effects[0])}"
        remark = "any flexible effect reduces any gap a little"
        controls.append(_bar(scale, "wrong", text, remark, wrong.gap_after_N, after_ci95_N(d, wrong)))
    if math.isfinite(ceiling):
        remark = "without physics: any smooth function with a memory"
        controls.append(_bar(scale, "ceiling", "Generic learner", remark, ceiling, None))
    is_cut = any(bar.css.endswith(" cut") for bar in (*steps, *controls))
    return GapSteps(tuple(steps), tuple(controls), steps[-1].length, is_cut)


def has_correction(d: Diagnosis) -> bool:
    """Return whether the references changed the gap."""
    return abs(d.gap.corrected_N - d.gap.rms_N) > SAME * d.gap.rms_N


def after_ci95_N(d: Diagnosis, explanation: Explanation) -> Interval | None:
    """Return the interval [N] of the gap after, from that of the shrink; None if it is unknown."""
    ends = [explanation.gap_after_N + d.base_N * (explanation.shrink - s) for s in explanation.shrink_ci95[::-1]]
    return (max(ends[0], 0.0), ends[1]) if all(map(math.isfinite, ends)) else None


def _next_step(d: Diagnosis, writing: str = "") -> str:
    """Return what to do after this diagnosis; `writing` says how to come by its file where that may not be there."""
    if d.next_experiment is not None:
        purpose = d.next_experiment.purpose
        return f"Record the experiment {effect_name(d.next_experiment.name)} (below): {purpose.rstrip('.')}."
    hidden = d.verdict == NO_GAP and d.gap.rms_N > EvidenceLimits.VISIBLE * d.gap.noise_floor_N
    if hidden and d.correction is not None:
        return "Take a better simulation: its own error hides smaller effects."
    if hidden:
        return "Record references (--reference), or take a better simulation: its own error hides smaller effects."
    if d.verdict == NO_GAP:
        return "Nothing: simulation and measurement agree within what can be seen."
    if d.verdict == NAMED:
        return f"Use augmented.json{writing}, the simulation with {join_effect_names(d.composition.effects)}."
    references = "" if d.correction is not None else ", and references that are free of the effect"
    return f"Record other strokes and currents{references}."


def _key_figure(d: Diagnosis) -> dict[str, str]:
    """Return the most important figure with its unit and an explanation."""
    c = d.composition
    if d.verdict == UNKNOWN:
        closest = find_closest(d)
        before_N = d.gap.corrected_N if d.gap.corrected_N > 0.0 else math.nan
        figure, unit = percent(1.0 if closest is None else closest.gap_after_N / before_N), "%"
        share = 1.0 - d.ceiling_after_N / before_N
        learnt = "nothing of it" if share <= 0.0 else f"{percent(share)}\N{NO-BREAK SPACE}%"
        text = f"of the gap{describe_correction(d)} on held-out recordings remains unexplained by known effects; "
        text += f"a generic learner explains {learnt}."
    elif d.verdict == NO_GAP or not c.effects:
        figure, unit, noise = three_figures(d.gap.rms_N), "N", three_figures(d.gap.noise_floor_N)
        text = f"between simulation and measurement; the measurement noise is {noise} N."
    else:
        figure, unit = percent(c.shrink), "%"
        names = join_effect_names(c.effects) + (" (best fit)" if d.verdict == AMBIGUOUS else "")
        interval = f"95\N{NO-BREAK SPACE}% interval {percents(c.shrink_ci95)}"
        beyond = "" if d.is_recalibrated else describe_correction(d)
        text = f"of the gap{beyond} on held-out recordings closed by {names}; {interval}."
    return {"figure": figure, "unit": unit, "text": text}


def _warnings(d: Diagnosis) -> list[str]:
    """Return what a reader must know before the result; the other notes are at the end of the page."""
    texts = [f"{sentence_case(note)}." for note in d.seen_notes]
    if d.is_recorded and d.twin is not None:
        cost = three_figures(d.twin.cost_J)
        text = "The simulation is available only as recorded predictions. Effects on position and current were "
        text += f"evaluated with a {d.twin.body.kind} network fitted to these predictions; its cost J is {cost} %."
        texts.append(text)
    return texts


def _open_questions(d: Diagnosis) -> list[tuple[str, list[str]]]:
    """Return headings and sentences about what these recordings leave open."""
    same = "give the same force on these recordings, within the noise."
    absorbed = "a recalibration of the simulation would have the same effect. Record references to separate the two."
    separable = [f"{sentence_case(join_effect_names(d.not_separable))}: {absorbed}"] if d.not_separable else []
    questions = {
        "Indistinguishable effects": [f"{sentence_case(join_effect_names(g))} {same}" for g in d.indistinguishable],
        "Not separable from calibration": separable,
        "Not visible in these recordings": [
            f"{sentence_case(effect_name(e))}: {reason.rstrip('.')}." for e, reason in d.invisible
        ],
    }
    return [(heading, sentences) for heading, sentences in questions.items() if sentences]


def _where(ident: str, what: str, where: Where) -> dict[str, Any]:
    """Return the sentence and the figures that locate `what`."""
    r, p = where.strongest, where.max_p_value
    sentence = f"No region stands out: the {what} is spread over the whole operating range."
    if r is not None and p <= RegionLimits.SIGNIFICANT:
        energy, samples = percent(r.share_of_energy), percent(r.share_of_samples)
        sentence = f"The {what} is most concentrated at {region_name(r)}: {energy} % of its energy in {samples} % of "
        sentence += f"the time (p = {p:.2g} over all regions)."
    charts, maps = draw_share_charts(ident, where.regions), draw_gap_maps(f"{ident}-map", where.maps)
    return {"sentence": sentence, "share_charts": charts, "maps": maps}


def _plots(d: Diagnosis, effects: str) -> dict[str, Any] | None:
    worst = find_largest_errors(d.held_out)
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


def _bar(scale: float, css: str, label: str, remark: str, value: float, ci95: Interval | None) -> Bar:
    def percent_of_scale(value: float) -> float:
        return min(100.0 * value / scale, 100.0) if math.isfinite(value) else 0.0

    css, shown, interval, whisker = f"{css} cut" if value > scale else css, three_figures(value), "", None
    if ci95 is not None and all(map(math.isfinite, ci95)):
        low, high = map(percent_of_scale, ci95)
        whisker = low, high - low
        shown, interval = format_within(value, *ci95)
    return Bar(css, label, remark, shown, interval, percent_of_scale(value), whisker)
