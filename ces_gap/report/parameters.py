"""A diagnosis in which parameters of the simulation were freed first: its verdict, causes and sentence with them."""

from __future__ import annotations

import math
from dataclasses import replace

from ces_gap.calibrate.calibration import FittedParameter, FreedParameters
from ces_gap.calibrate.parameters import NAME
from ces_gap.diagnosis import (
    AMBIGUOUS,
    NAMED,
    NO_GAP,
    UNKNOWN,
    Diagnosis,
    Estimate,
    Explanation,
    describe_rare,
    describe_timing,
    format_verdict,
)
from ces_gap.effects.effect import Composition, Setting
from ces_gap.inference.judgement import ALTERNATIVES, CALIBRATION, REMAINS, TIMING, UNCERTAIN
from ces_gap.limits import VerdictLimits
from ces_gap.report.calibration import describe_alternative, describe_setting, describe_values
from ces_report.typesetting import format_number, join_with


def with_parameters(d: Diagnosis, chosen: FreedParameters) -> Diagnosis:
    """Return the diagnosis of the calibrated simulation as one of the original: its parameters are a cause, too."""
    if chosen.setting is None:
        d = replace(d, sentence=format_verdict(d) + describe_rare(d) + describe_timing(d))
        return _with_alternatives(d, chosen) if d.verdict in (NAMED, AMBIGUOUS) else d
    parameters = _explain(d, chosen, chosen.setting)
    values, shrinks = describe_values(chosen.freed), "shrinks" if d.gap.corrected_N < d.gap.rms_N else "grows"
    sizes = f"from {_newtons(d.gap.rms_N)} to {_newtons(d.gap.corrected_N)} RMS"
    alone = f"With {_count(chosen)} the gap {shrinks} {sizes}"
    sentence = f"{values}. {alone} on held-out recordings."
    if d.verdict == NO_GAP:
        d = replace(d, verdict=NAMED, no_gap_reason="", composition=parameters, sentence=sentence, alternatives=())
        d = replace(d, next_experiment=None, probability_none=0.0)
    elif d.verdict == NAMED and not {*d.composition.effects} & {CALIBRATION, TIMING}:
        missing = join_with([describe_setting(s) for s in d.composition.composition.settings])
        verb = "is" if len(d.composition.effects) == 1 else "are"
        every = "both" if len(chosen.freed) + len(d.composition.effects) == 2 else "all"
        text = f"{values}. Beside {_count(chosen)}, {missing} {verb} missing. {alone}, with {every} it is "
        d = replace(d, sentence=f"{text}{_newtons(d.composition.gap_after_N)}, on held-out recordings.")
        d = replace(d, composition=_join(parameters, d.composition))
    else:
        beyond = replace(d, gap=replace(d.gap, rms_N=d.gap.corrected_N, ci95_N=d.gap.corrected_ci95_N))
        text = f"{sentence} Beside {_count(chosen)}: {_lower(format_verdict(beyond))}{describe_rare(d)}"
        d = replace(d, sentence=text)
        if d.verdict == UNKNOWN and d.gap.corrected_N <= max(
            d.tolerance_N, VerdictLimits.TENTH * d.gap.rms_N
        ):  # little is left
            d = replace(
                d, verdict=AMBIGUOUS, doubt=REMAINS, probability_unknown=min(d.probability_unknown, VerdictLimits.TENTH)
            )
        d = replace(d, composition=_join(parameters, d.composition))
    return _with_alternatives(_weigh(d, parameters), chosen)


def with_changes(d: Diagnosis) -> Diagnosis:
    """Return the diagnosis with what parameters were before that have changed since the references were recorded."""
    causes, composition = tuple(map(_with_defaults, d.causes)), _with_defaults(d.composition)
    own = [e for found in composition.estimates for e in found if math.isfinite(e.default)]
    changed = [e for e in own if not e.ci95[0] <= e.default <= e.ci95[1]]
    words = describe_values([FittedParameter(e.name, e.value, e.ci95, e.default) for e in changed])
    sentence = f"{d.sentence} {words}." if changed and d.verdict in (NAMED, AMBIGUOUS) else d.sentence
    return replace(d, causes=causes, composition=composition, sentence=sentence)


def _with_defaults(one: Explanation) -> Explanation:
    def complete(setting: Setting, found: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
        pairs = zip(found, setting.effect.parameters, strict=True)
        own = setting.name == NAME
        return tuple(replace(e, default=p.starts[0]) for e, p in pairs) if own else found

    return replace(one, estimates=tuple(map(complete, one.composition.settings, one.estimates)))


def _explain(d: Diagnosis, chosen: FreedParameters, setting: Setting) -> Explanation:
    """Return the parameters as an explanation of the original gap."""
    before_N, after_N = max(d.gap.rms_N, 1e-9), d.gap.corrected_N
    low, high = (1.0 - end / before_N for end in d.gap.corrected_ci95_N[::-1])
    found = tuple(Estimate(p.name, p.value, p.ci95, p.at_bound, default=p.default) for p in chosen.freed)
    composition, shrink = Composition((setting,)), 1.0 - after_N / before_N
    return Explanation((NAME,), (setting.effect.form,), composition, (found,), after_N, shrink, (low, high))


def _join(parameters: Explanation, effects: Explanation) -> Explanation:
    """Return the explanation by the parameters and effects beside them; both shrink the original gap."""
    left = 1.0 - parameters.shrink
    shrink, *ends = (1.0 - left * (1.0 - share) for share in (effects.shrink, *effects.shrink_ci95))
    return replace(
        effects,
        shrink=shrink,
        shrink_ci95=(ends[0], ends[1]),
        effects=(*parameters.effects, *effects.effects),
        forms=(*parameters.forms, *effects.forms),
        composition=Composition((*parameters.composition.settings, *effects.composition.settings)),
        estimates=(*parameters.estimates, *effects.estimates),
        without_N=(),
    )


def _weigh(d: Diagnosis, parameters: Explanation) -> Diagnosis:
    """Return the diagnosis with the parameters as its first cause: as probable as that any cause is known.

    Effects beside them keep half of their probability, which is that of the composition; others lose what is left.
    """
    known, unknown = 1.0 - d.probability_unknown, d.probability_unknown
    beside = [c.effects[0] for c in d.causes if c.effects[0] in d.composition.effects]
    shares = {c.effects[0]: c.probability * (0.5 if c.effects[0] in beside else 0.0) for c in d.causes}
    causes = [replace(c, probability=min(shares[c.effects[0]], known)) for c in d.causes]
    own = replace(parameters, probability=max(known - sum(c.probability for c in causes), 0.0))
    return replace(d, causes=(own, *causes), probability_none=0.0, probability_unknown=unknown)


def _with_alternatives(d: Diagnosis, chosen: FreedParameters) -> Diagnosis:
    """Return the diagnosis with what explains the gap as well, and with what makes a value a doubt."""
    doubts = [p.name for p in chosen.freed if p.is_doubtful]
    text, verdict, doubt, others = d.sentence, d.verdict, d.doubt, d.alternatives
    found = {*(p.name for p in chosen.freed), *d.composition.effects} - {NAME}
    instead = [one for one in chosen.alternatives if {*one.names} != found]
    if instead and verdict != UNKNOWN:
        names = [NAME if a.effect is None else a.effect.name for a in instead]
        others = tuple(dict.fromkeys((*others, *(n for n in names if n not in d.composition.effects))))
        text += f" As much would be explained by {'; or by '.join(map(describe_alternative, instead))}."
        verdict, doubt = AMBIGUOUS, ALTERNATIVES
        d = replace(d, explained_as_well=tuple(one.names for one in instead))
    if doubts:
        verb = "lies" if len(doubts) == 1 else "lie"
        text += f" {join_with(doubts)} {verb} at a bound or far from the default: a sign that something is missing."
        verdict, doubt = (AMBIGUOUS, doubt or UNCERTAIN) if verdict == NAMED else (verdict, doubt)
    return replace(d, sentence=text, verdict=verdict, doubt=doubt, alternatives=others)


def _count(chosen: FreedParameters) -> str:
    return {1: "it", 2: "both"}.get(len(chosen.freed), "them")


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def _newtons(value: float) -> str:
    return f"{format_number(value)} N"
