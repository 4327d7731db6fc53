"""The words of a verdict, and of one in which parameters of the simulation were freed first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ces_gap.calibrate.calibration import FittedParameter, FreedParameters
from ces_gap.diagnosis import Diagnosis, Estimate, Explanation, calibration_cells, find_closest
from ces_gap.effects.effect import Composition, Setting
from ces_gap.inference.explanation import share_probabilities
from ces_gap.inference.judgement import (
    AMBIGUOUS,
    CALIBRATION,
    NAMED,
    NO_GAP,
    PARAMETERS,
    TIMING,
    UNKNOWN,
    Doubt,
    Probabilities,
    Within,
)
from ces_gap.inference.verdict import make_possible
from ces_gap.limits import VerdictLimits
from ces_gap.report.calibration import (
    describe_alternative,
    describe_doubtful,
    describe_setting,
    describe_values,
)
from ces_gap.report.formatting import join_effect_names, newtons
from ces_report.typesetting import format_number, format_range, join_with, minus


def format_verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    gap, after_N, effects = diagnosis.gap, diagnosis.composition.gap_after_N, _causes(diagnosis, diagnosis.composition)
    if diagnosis.verdict == NO_GAP:
        return _describe_no_gap(diagnosis)
    if diagnosis.verdict == UNKNOWN:
        size = f"{newtons(gap.corrected_N)} RMS{describe_correction(diagnosis)}"
        return f"None of the known effects explains the gap of {size}{_describe_rest(diagnosis)}."
    shrink = f"the gap{describe_correction(diagnosis)} {_describe_shrink(gap.corrected_N, after_N)}"
    if diagnosis.verdict == AMBIGUOUS:
        ambiguity = _describe_ambiguity(diagnosis)
        fitted = (
            f"with {join_effect_names(effects)}, {shrink}" if effects else "what was fitted enlarges the held-out gap"
        )
        return f"{ambiguity[:1].upper()}{ambiguity[1:]}; {fitted}{_describe_fewer(diagnosis)}."
    if tuple(effects) == (CALIBRATION,):
        cell = max(calibration_cells(diagnosis), key=lambda c: abs(c.force_N))
        speed, current = f"{format_range(*cell.speed_m_s)} m/s", f"{format_number(float(np.mean(cell.current_A)))} A"
        size = f"most at {speed} and about {current} ({cell.force_N:+.0f} N)"
        return f"The simulation's calibration is off, {size}: recalibrated, {shrink} on held-out recordings."
    added = "this effect" if len(effects) == 1 else "these"
    named = f"The gap is caused by {join_effect_names(effects)}: with {added} added, {shrink} on held-out recordings"
    imitated = [e for e in effects if e in diagnosis.not_separable and CALIBRATION not in effects]
    return f"{named}; a recalibration of the simulation would explain it, too." if imitated else f"{named}."


def describe_correction(diagnosis: Diagnosis) -> str:
    """Return the words that tell the corrected gap from the original one where the correction takes a part of it."""
    gap = diagnosis.gap
    if not gap.corrected_N < gap.rms_N or newtons(gap.corrected_N) == newtons(gap.rms_N):
        return ""
    if diagnosis.is_recalibrated:
        return " that the parameters leave"
    return " beyond the timing of its inputs" if diagnosis.correction is None else " beyond the simulation's own error"


def _describe_shrink(before_N: float, after_N: float) -> str:
    before, after = newtons(before_N), newtons(after_N)
    verb = "grows" if after_N > before_N else "shrinks"
    return f"of {before} RMS hardly {verb}" if before == after else f"{verb} from {before} to {after} RMS"


def _describe_fewer(diagnosis: Diagnosis) -> str:
    """Return which fewer effects leave less of the held-out gap than those together; empty if none do.

    The effects are chosen on the other recordings: held-out ones do not choose.
    """
    together = diagnosis.composition
    names, gaps_N = together.effects, together.without_N
    if len(names) < 2:
        return ""
    fewer = {f"{join_effect_names(c.effects)} alone": c.gap_after_N for c in diagnosis.causes if len(c.effects) == 1}
    fewer |= {f"those without {join_effect_names([e])}": gap_N for e, gap_N in zip(names, gaps_N, strict=False)}
    best = min(fewer, key=lambda which: (math.isnan(fewer[which]), fewer[which]), default="")
    if not best or not fewer[best] < together.gap_after_N or newtons(fewer[best]) == newtons(together.gap_after_N):
        return ""
    return f", but fewer effects leave less on held-out recordings: {best} {newtons(fewer[best])}"


def _describe_rest(diagnosis: Diagnosis) -> str:
    """Return what the closest explanation and a learner leave of an unknown gap, and whether its noise is known."""
    closest, text = find_closest(diagnosis), ""
    if closest is not None:
        names = join_effect_names(_causes(diagnosis, closest) or closest.effects)
        text = f"; the closest, {names}, leaves {newtons(closest.gap_after_N)}"
        if diagnosis.ceiling_after_N < closest.gap_after_N:
            text += f", a learner without physics {newtons(diagnosis.ceiling_after_N)}"
    return text if diagnosis.gap.noise_known else f"{text}; noise not known: {diagnosis.gap.noise_source}"


def describe_timing(diagnosis: Diagnosis) -> str:
    """Return a sentence on what the simulation does to its inputs, empty if that was not corrected."""
    gap, probe = diagnosis.gap, diagnosis.probe
    if not probe.corrected:
        return ""
    findings = " and ".join(
        f"{finding.about.lower()} {finding.found}" for finding in probe.findings if finding.is_corrected
    )
    timing = f" The simulation's timing of its inputs ({findings}) is"
    if diagnosis.correction is not None or not describe_correction(diagnosis):
        return f"{timing} corrected first."
    cause = "the cause" if diagnosis.verdict == NO_GAP else "a cause, too"
    return f"{timing} {cause}: corrected, {newtons(gap.corrected_N)} of {newtons(gap.rms_N)} RMS are left."


def describe_rare(diagnosis: Diagnosis) -> str:
    """Return a sentence on the largest local deviation, with its place; empty if none stands out."""
    rare = diagnosis.rare
    if rare is None:
        return ""
    size = f"{minus(f'{rare.mean_N:+.3g}')} N over {format_number(1e3 * rare.window_s)} ms"
    inputs = f"stroke {format_number(1e3 * rare.stroke_m)} mm, speed {format_number(rare.speed_m_s)} m/s"
    where = f"{rare.time_s:.2f} s of {rare.recording} ({inputs}, current {format_number(rare.current_A)} A)"
    return (
        f" A short deviation stands out, which an RMS hides: {size} at {where}; expected at most {rare.limit_N:.3g} N."
    )


def _describe_no_gap(diagnosis: Diagnosis) -> str:
    gap, reason = diagnosis.gap, diagnosis.no_gap_reason
    left_N = min(gap.corrected_N, gap.rms_N)
    noise = f"the measurement noise of {gap.noise_floor_N:.1f} N RMS (from {gap.noise_source})"
    if reason == Within.TOLERANCE:
        limit = f"the tolerance of {diagnosis.tolerance_N:.1f} N"
        if diagnosis.probe.corrected and gap.rms_N > diagnosis.tolerance_N:
            return f"No gap beyond the timing of the simulation's inputs: {left_N:.1f} N RMS remain, within {limit}."
        return f"No gap above {limit}: {left_N:.1f} N RMS between simulation and measurement."
    errors_N = [float(f"{s.trace.own_error_N:.3g}") for s in diagnosis.held_out]
    if reason == Within.BASELINE_ERROR and any(errors_N):
        own = f"the model's own error of {format_range(min(errors_N), max(errors_N))} N"
        hidden = f"effects below about {diagnosis.visible_from_N:.0f} N RMS cannot be seen"
        return f"No gap: {left_N:.0f} N RMS between simulation and measurement, within {own}; {hidden} behind it."
    if reason == Within.BASELINE_ERROR:
        left, whole = f"{left_N:.0f} N", f"{gap.rms_N:.0f} N RMS"
        explained = f"the references explain all but {left} of the {whole}"
        explained = f"{whole} are left, as on references" if f"{left} RMS" == whole else explained
        hidden = f"effects below about {diagnosis.visible_from_N:.0f} N RMS cannot be seen"
        return f"No gap beyond the simulation's own error: {explained}; {hidden} behind this simulation's error."
    if reason == Within.NOISE:
        return f"No gap: {left_N:.1f} N RMS remain, within {noise}."
    timed = f"corrected, {diagnosis.timed_N:.1f} of {left_N:.1f} N RMS remain, within {noise}"
    return f"No gap beyond the simulation's timing of at most a sample: {timed}."


def _causes(diagnosis: Diagnosis, explanation: Explanation) -> list[str]:
    """Return the effects of an explanation, the one that closes most alone first."""
    alone = {c.effects[0]: c.gap_after_N for c in diagnosis.causes}
    return sorted(explanation.effects, key=lambda e: alone.get(e, np.inf))


def _describe_ambiguity(diagnosis: Diagnosis) -> str:
    """Return what keeps a cause from being named."""
    effects, others = _causes(diagnosis, diagnosis.composition), diagnosis.alternatives
    if diagnosis.doubt == Doubt.ALTERNATIVES:
        after = {c.effects[0]: c.gap_after_N for c in diagnosis.causes}
        group = next((g for g in diagnosis.indistinguishable if set(g) & set(effects) and set(g) & set(others)), ())
        alike = sorted({*group} & {*effects, *others}, key=lambda e: (after.get(e, np.inf), e))
        if alike:
            return f"these recordings cannot distinguish between {join_effect_names(alike)}"
        return f"these recordings do not rule out {join_effect_names(others, 'or')}"
    if diagnosis.doubt == Doubt.SIMULATION_ERROR:
        imitated = [e for e in effects if e in diagnosis.not_separable]
        return f"{join_effect_names(imitated or effects)} may be an error of the simulation itself"
    if diagnosis.doubt == Doubt.REMAINS:
        rest = f", as a learner without physics leaves {newtons(diagnosis.ceiling_after_N)}"
        return f"something else remains beside {join_effect_names(effects)}{'' if diagnosis.rare else rest}"
    return {
        Doubt.NOT_CONFIRMED: "the held-out recordings do not confirm the best explanation",
        Doubt.UNDETERMINED: "the interval of an effect's size includes no effect",
        Doubt.LEAVES_MORE: "the best explanation leaves more of the gap's energy than it closes",
    }.get(diagnosis.doubt, "the best explanation is not certain enough to be named")


def with_parameters(d: Diagnosis, chosen: FreedParameters) -> Diagnosis:
    """Return the diagnosis of the calibrated simulation as one of the original: its parameters are a cause, too."""
    if chosen.setting is None:
        d = replace(d, sentence=format_verdict(d) + describe_rare(d) + describe_timing(d))
        return _with_alternatives(d, chosen) if d.verdict in (NAMED, AMBIGUOUS) else d
    parameters = _explain(d, chosen, chosen.setting)
    if d.verdict == NO_GAP:
        d = _name_parameters(d, chosen, parameters)
    elif d.verdict == NAMED and not {*d.composition.effects} & {CALIBRATION, TIMING}:
        d = _name_both(d, chosen, parameters)
    else:
        d = _add_parameters(d, chosen, parameters)
    return _with_alternatives(_weigh(d, parameters), chosen)


def _name_parameters(d: Diagnosis, chosen: FreedParameters, parameters: Explanation) -> Diagnosis:
    """Return the diagnosis of a gap that the parameters close: they are the cause."""
    sentence = f"{describe_values(chosen.freed)}. {_describe_change(d, chosen)} on held-out recordings."
    named = replace(d, verdict=NAMED, no_gap_reason="", composition=parameters, sentence=sentence, alternatives=())
    return replace(named, next_experiment=None, probability_none=0.0)


def _name_both(d: Diagnosis, chosen: FreedParameters, parameters: Explanation) -> Diagnosis:
    """Return the diagnosis with parameters and effects beside them as the cause."""
    effects = d.composition
    missing = join_with([describe_setting(s) for s in effects.composition.settings])
    verb = "is" if len(effects.effects) == 1 else "are"
    every = "both" if len(chosen.freed) + len(effects.effects) == 2 else "all"
    text = f"{describe_values(chosen.freed)}. Beside {_count(chosen)}, {missing} {verb} missing. "
    text += f"{_describe_change(d, chosen)}, with {every} it is {newtons(effects.gap_after_N)}, on held-out recordings."
    return replace(d, sentence=text, composition=_combine(parameters, effects))


def _add_parameters(d: Diagnosis, chosen: FreedParameters, parameters: Explanation) -> Diagnosis:
    """Return the diagnosis of what the parameters leave; it is no unknown cause if that is little."""
    beyond = replace(d, gap=replace(d.gap, rms_N=d.gap.corrected_N, ci95_N=d.gap.corrected_ci95_N))
    text = f"{describe_values(chosen.freed)}. {_describe_change(d, chosen)} on held-out recordings. "
    text += f"Beside {_count(chosen)}: {_lower(format_verdict(beyond))}{describe_rare(d)}"
    d, tenth = replace(d, sentence=text, composition=_combine(parameters, d.composition)), VerdictLimits.TENTH
    if d.verdict == UNKNOWN and d.gap.corrected_N <= max(d.tolerance_N, tenth * d.gap.rms_N):
        return replace(d, verdict=AMBIGUOUS, doubt=Doubt.REMAINS, probability_unknown=min(d.probability_unknown, tenth))
    return d


def _describe_change(d: Diagnosis, chosen: FreedParameters) -> str:
    """Return what the parameters alone do to the gap."""
    verb = "shrinks" if d.gap.corrected_N < d.gap.rms_N else "grows"
    return f"With {_count(chosen)} the gap {verb} from {newtons(d.gap.rms_N)} to {newtons(d.gap.corrected_N)} RMS"


def with_changes(d: Diagnosis) -> Diagnosis:
    """Return the diagnosis with what parameters were before that have changed since the references were recorded."""
    causes, composition = tuple(map(_with_defaults, d.causes)), _with_defaults(d.composition)
    own = [e for estimates in composition.estimates for e in estimates if math.isfinite(e.default)]
    changed = [e for e in own if not e.ci95[0] <= e.default <= e.ci95[1]]
    words = describe_values([FittedParameter(e.name, e.value, e.ci95, e.default) for e in changed])
    sentence = f"{d.sentence} {words}." if changed and d.verdict in (NAMED, AMBIGUOUS) else d.sentence
    return replace(d, causes=causes, composition=composition, sentence=sentence)


def _with_defaults(explanation: Explanation) -> Explanation:
    def complete(setting: Setting, estimates: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
        pairs = zip(estimates, setting.effect.parameters, strict=True)
        own = setting.name == PARAMETERS
        return tuple(replace(e, default=p.starts[0]) for e, p in pairs) if own else estimates

    return replace(explanation, estimates=tuple(map(complete, explanation.composition.settings, explanation.estimates)))


def _explain(d: Diagnosis, chosen: FreedParameters, setting: Setting) -> Explanation:
    """Return the parameters as an explanation of the original gap."""
    before_N, after_N = max(d.gap.rms_N, 1e-9), d.gap.corrected_N
    low, high = (1.0 - end / before_N for end in d.gap.corrected_ci95_N[::-1])
    explanation = _as_explanation(setting, chosen.freed)
    return replace(explanation, gap_after_N=after_N, shrink=1.0 - after_N / before_N, shrink_ci95=(low, high))


def _as_explanation(setting: Setting, parameters: Sequence[FittedParameter] = ()) -> Explanation:
    """Return an effect, or parameters of the simulation, as an explanation that no held-out recording has tested."""
    unknown = math.nan, math.nan
    estimates = tuple(Estimate(p.name, p.value, p.ci95, p.at_bound, default=p.default) for p in parameters) or tuple(
        Estimate(p.name, value, unknown) for p, value in zip(setting.effect.parameters, setting.values, strict=True)
    )
    composition = Composition((setting,))
    return Explanation((setting.name,), (setting.effect.form,), composition, (estimates,), *unknown, unknown)


def _combine(parameters: Explanation, effects: Explanation) -> Explanation:
    """Return the explanation by the parameters and effects beside them; both shrink the original gap."""
    own, theirs = ((one.shrink, *one.shrink_ci95) for one in (parameters, effects))
    shrink, low, high = (1.0 - (1.0 - a) * (1.0 - b) for a, b in zip(own, theirs, strict=True))
    return replace(
        effects,
        shrink=shrink,
        shrink_ci95=(low, high),
        effects=(*parameters.effects, *effects.effects),
        forms=(*parameters.forms, *effects.forms),
        composition=Composition((*parameters.composition.settings, *effects.composition.settings)),
        estimates=(*parameters.estimates, *effects.estimates),
        without_N=(),
    )


def _weigh(d: Diagnosis, parameters: Explanation) -> Diagnosis:
    """Return the diagnosis with the parameters as its first cause: as probable as that any cause is known.

    The other effects shrink that part of the original gap which the parameters leave.
    """
    together, left = replace(d.composition, probability=1.0 - d.probability_unknown), 1.0 - parameters.shrink
    causes = [parameters]
    for c in d.causes:
        low, high = (left * share for share in c.shrink_ci95)
        causes.append(replace(c, probability=0.0, shrink=left * c.shrink, shrink_ci95=(low, high)))
    return replace(d, causes=tuple(causes), composition=together, probability_none=0.0)


def _with_alternatives(d: Diagnosis, chosen: FreedParameters) -> Diagnosis:
    """Return the diagnosis with what explains the gap as well, and with what makes a value a doubt."""
    doubts = describe_doubtful(chosen.freed)
    text, verdict, doubt, others = d.sentence, d.verdict, d.doubt, d.alternatives
    names_shown = {*(p.name for p in chosen.freed), *d.composition.effects} - {PARAMETERS}
    instead = [alternative for alternative in chosen.alternatives if {*alternative.names} != names_shown]
    if instead and verdict != UNKNOWN:
        names = [PARAMETERS if a.effect is None else a.effect.name for a in instead]
        others = tuple(dict.fromkeys((*others, *(n for n in names if n not in d.composition.effects))))
        text += f" As much would be explained by {'; or by '.join(map(describe_alternative, instead))}."
        verdict, doubt = AMBIGUOUS, Doubt.ALTERNATIVES
        settings = [(a.effect or a.freed, () if a.effect else a.parameters) for a in instead]
        untested = {s.name: _as_explanation(s, own) for s, own in settings if s and s.name in others}
        causes = *(untested.pop(c.effects[0], c) for c in d.causes), *untested.values()
        d = replace(d, causes=causes, explained_as_well=tuple(alternative.names for alternative in instead))
    if doubts:
        text = " ".join([text, *doubts])
        verdict, doubt = (AMBIGUOUS, doubt or Doubt.UNCERTAIN) if verdict == NAMED else (verdict, doubt)
    return _share(replace(d, sentence=text, verdict=verdict, doubt=doubt, alternatives=others))


def _share(d: Diagnosis) -> Diagnosis:
    """Return the diagnosis with probabilities that leave the alternatives possible which its sentence names."""
    together = d.composition.effects
    odds = {c.effects[0]: c.probability for c in d.causes}
    odds |= dict.fromkeys(together, d.composition.probability / max(len(together), 1))
    shared = Probabilities(d.probability_none, d.probability_unknown, odds)
    if d.alternatives:
        shared = make_possible(shared, d.alternatives, together)
    causes, composition = share_probabilities(shared.effects, d.causes, d.composition)
    return replace(d, causes=causes, composition=composition)


def _count(chosen: FreedParameters) -> str:
    return {1: "it", 2: "both"}.get(len(chosen.freed), "them")


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]
