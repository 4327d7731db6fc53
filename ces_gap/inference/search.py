"""Which effects explain the gap: every form is fitted alone, then compositions are searched with joint refits.

Effects are added by beam search, then each is removed or replaced and the rest refitted. The data left out decide:
explanations are compared by their residuals on units left out, paired by blocks; a composition grows only while that
gain exceeds twice its error and a share of the gap. Replacements that explain the evidence about as well are
alternatives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import Effect
from ces_gap.effects.simulation_errors import CALIBRATION_FORMS
from ces_gap.inference.both_sides import explain_static_map
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, count_stuck_parameters, fit_alone, fit_together
from ces_gap.inference.refinement import Refinement
from ces_gap.inputs.checks import is_current_constant
from ces_gap.limits import EvidenceLimits, SearchLimits, VerdictLimits
from ces_gap.progress import Progress, ignore_progress

BEAM = 2
MAX_ADDITIONS = 3  # additions refitted jointly for each composition in the beam
MAX_SWAPS = 3  # replacements fitted for each effect
MAX_REFINED_SWAPS = 2  # the best of these
REFINE_SWAPS_WITHIN_SHARE = 0.2  # of the gap's energy, by which one that is refined may leave more than the best
MAX_REFINED_FORMS = 10
REFINE_FORMS_WITHIN_SHARE = 0.4  # the same for the forms of single effects
ALIKE_AT_CONSTANT_CURRENT = frozenset(("current_scale", "force_scale"))


@dataclass(frozen=True)
class EffectSearchResult:
    """`baseline_residual` (r,) is the whitened residual without effects; `alone` the best form of each effect, ranked.

    `tried` are compositions of as many effects as the best, refitted with one of its effects replaced.
    """

    baseline_residual: F
    alone: tuple[EffectFit, ...]
    best: EffectFit | None
    gap_energy: float  # whitened sum of squares above the noise's
    evidence: Evidence
    tried: tuple[EffectFit, ...] = ()


def search(
    evidence: Evidence,
    effects: Sequence[Effect],
    refinement: Refinement,
    threads: int,
    progress: Progress = ignore_progress,
    min_gain_share: float = SearchLimits.MIN_GAIN,
) -> EffectSearchResult:
    """Return the best explanations of the evidence by the effects.

    `refinement` repeats the most promising fits with the simulation itself where the evidence holds its twin. Each
    further effect must explain `min_gain_share` of the gap's energy.
    """
    forms: list[EffectFit] = []
    with ThreadPoolExecutor(max(1, threads)) as pool:
        for fit in pool.map(lambda effect: fit_alone(evidence, effect), effects):
            forms.append(fit)
            progress(f"fitting {fit.names[0]}", len(forms) / len(effects))
    residual = evidence.residual(evidence.alone)
    energy = max(float(residual @ residual) - len(residual), EvidenceLimits.MIN_GAP_ENERGY * len(residual))
    forms.sort(key=lambda f: f.cost)
    limit = forms[0].cost + REFINE_FORMS_WITHIN_SHARE * energy
    for k, fit in enumerate([f for f in forms[:MAX_REFINED_FORMS] if f.cost < limit]):
        progress(f"running the simulation with {fit.names[0]}", k / MAX_REFINED_FORMS)
        forms[k] = refinement.refine(evidence, fit)
    alone = order_nested_forms(evidence, best_forms(forms, energy), energy)
    several = explain_static_map(evidence, forms[0], energy, effects, threads, progress)
    if several is not None:
        return EffectSearchResult(residual, alone, several, energy, evidence)
    compositions = CompositionSearch(evidence, residual, forms, energy, refinement, threads, min_gain_share)
    best = compositions.grow(alone, progress)
    tried: tuple[EffectFit, ...] = ()
    if best is not None and len(best.effects) > 1:
        progress("trying other effects in place of each", 0.0)
        best, tried = compositions.improve(best)
    if best is not None and len(best.effects) == 1:  # what is left of a composition may be better than its first fit
        alone = tuple(best if f.names == best.names and best.cost < f.cost else f for f in alone)
    return EffectSearchResult(residual, alone, best, energy, evidence, tried)


def best_forms(forms: Sequence[EffectFit], energy: float) -> tuple[EffectFit, ...]:
    """Return one form of each effect, best first: one with more parameters only if it explains clearly more."""
    chosen: dict[str, EffectFit] = {}
    for fit in sorted(forms, key=lambda f: len(f.searched)):
        simpler = chosen.get(fit.names[0])
        min_gain = SearchLimits.MIN_FORM_GAIN * energy if simpler and len(fit.searched) > len(simpler.searched) else 0.0
        if simpler is None or fit.cost < simpler.cost - min_gain:
            chosen[fit.names[0]] = fit
    return tuple(sorted(chosen.values(), key=lambda f: cost_with_penalty(f, energy)))


@dataclass(frozen=True)
class PairedGain:
    """Difference of two residuals' sums of squares (`energy`, whitened), and its standard `error`."""

    energy: float
    error: float

    @property
    def z(self) -> float:
        """Energy over its error."""
        return self.energy / max(self.error, 1e-12)


def compute_paired_gain(evidence: Evidence, worse: F, better: F) -> PairedGain:
    """Return the paired gain of whitened residual `better` (r,) over `worse` (r,); blocks are the samples."""
    by_block = np.bincount(evidence.block_of_row, worse**2 - better**2)
    count = len(by_block)
    error = float(by_block.std(ddof=1) * np.sqrt(count)) if count > 1 else float("inf")
    return PairedGain(float(by_block.sum()), error)


def cost_with_penalty(fit: EffectFit, energy: float) -> float:
    """Return the fit's cost plus a penalty for each parameter, by which explanations of this energy are ranked."""
    count = sum(len(e.parameters) for e in fit.effects if e.prior_share == 0.0)
    return fit.cost + SearchLimits.PARAMETER * energy * count + prior_cost(fit, energy)


def prior_cost(fit: EffectFit, energy: float) -> float:
    """Return the energy by which flexible maps must explain more than effects."""
    return energy * sum(e.prior_share for e in fit.effects)


def choose_best_fit(evidence: Evidence, fits: Sequence[EffectFit], energy: float) -> EffectFit:
    """Return the best fit of a gap of this energy; more parameters must pay their penalty or gain significantly."""
    best, *others = sorted(fits, key=lambda f: (len(f.searched), f.cost))
    for fit in others:
        if cost_with_penalty(fit, energy) < cost_with_penalty(best, energy) or (
            len(fit.searched) > len(best.searched)
            and is_worthwhile(evidence, best.left_out, fit, prior_cost(fit, energy) - prior_cost(best, energy))
        ):
            best = fit
    return best


def is_worthwhile(evidence: Evidence, before: F, after: EffectFit, min_energy: float) -> bool:
    """True if the fit gains more than `min_energy`, and more than twice its error or than noise could explain.

    A gain confined to a few blocks, as at a bump stop, has a large error between blocks however clear it is.
    """
    paired = compute_paired_gain(evidence, before, after.left_out)
    return paired.energy > min_energy and (
        paired.z > EvidenceLimits.MIN_GAIN_Z or paired.energy > EvidenceLimits.CLEAR_OF_NOISE * len(before)
    )


def loses_to_nested_form(evidence: Evidence, fit: EffectFit, other: EffectFit, energy: float) -> bool:
    """True if two fits of a gap of this `energy` differ in an effect and its limit only, and the data favour `other`.

    The form must gain more than twice the error of its gain over the limit, and inside the twin, which errs, the price
    of its further parameters. The limit wins if the form's best parameters are on a bound, where the form is no longer
    plausible, or if it leaves less by more than twice the error. Otherwise both are possible.
    """
    pairs = ((fit, other), (other, fit))
    mine, theirs = ([e for e in some.effects if e.name not in others.names] for some, others in pairs)
    if len(mine) != 1 or len(theirs) != 1:
        return False
    gain = compute_paired_gain(evidence, fit.left_out, other.left_out)
    better = gain.z > EvidenceLimits.MIN_GAIN_Z
    if theirs[0].limit == mine[0].name:
        price = SearchLimits.PARAMETER * energy * (len(other.searched) - len(fit.searched)) if theirs[0].edits else 0.0
        return better and gain.energy > price
    return mine[0].limit == theirs[0].name and (better or count_stuck_parameters(fit) > 0)


def order_nested_forms(evidence: Evidence, ranked: Sequence[EffectFit], energy: float) -> tuple[EffectFit, ...]:
    """Return the fits of single effects, best first, each before those that lose to it as a nested form."""
    ordered: list[EffectFit] = []
    for fit in ranked:
        place = [k for k, earlier in enumerate(ordered) if loses_to_nested_form(evidence, earlier, fit, energy)]
        ordered.insert(place[0] if place else len(ordered), fit)
    return tuple(ordered)


def fit_each(jobs: Sequence[tuple[Evidence, Sequence[EffectFit]]], threads: int) -> list[EffectFit]:
    """Return the joint fit of each job's parts on its evidence, in parallel."""
    with ThreadPoolExecutor(max(1, threads)) as pool:
        return list(pool.map(lambda job: fit_together(*job), jobs))


def split_composition(fit: EffectFit, forms: Sequence[EffectFit]) -> list[EffectFit]:
    """Return the single fits of a composition's effects, with the parameters of the composition."""
    singles = [next(f for f in forms if f.effects[0] == effect) for effect in fit.effects]
    stops = np.cumsum([len(effect.parameters) for effect in fit.effects])
    return [replace(f, searched=part) for f, part in zip(singles, np.split(fit.searched, stops[:-1]), strict=True)]


def rank_additions(fit: EffectFit, forms: Sequence[EffectFit], baseline_residual: F) -> list[EffectFit]:
    """Return one form of each effect that is not in `fit`, by its expected gain when added to `fit`, largest first.

    `baseline_residual` (r,) is the whitened residual without effects. The gain is the energy that a linear step along
    the tangents and the fitted signature explains; the signature helps where an effect is on its bound.
    """
    others = [f for f in forms if f.names[0] not in fit.names]
    best_form: dict[str, EffectFit] = {}
    for other in sorted(others, key=lambda form: -_linear_gain(fit, form, baseline_residual)):
        best_form.setdefault(other.names[0], other)
    return list(best_form.values())


def _linear_gain(fit: EffectFit, other: EffectFit, baseline_residual: F) -> float:
    tangents = np.column_stack([fit.jacobian, other.jacobian, baseline_residual - other.residual])
    scale = np.linalg.norm(tangents, axis=0)
    tangents = tangents[:, scale > 0.0] / scale[scale > 0.0]
    gram = tangents.T @ tangents + 1e-6 * np.eye(tangents.shape[1])
    slope = tangents.T @ fit.residual
    return float(slope @ np.linalg.solve(gram, slope))


@dataclass(frozen=True)
class CompositionSearch:
    """`baseline_residual` (r,) is the whitened residual without effects, `forms` their own fits, `energy` the gap's."""

    evidence: Evidence
    baseline_residual: F
    forms: Sequence[EffectFit]
    energy: float
    refinement: Refinement
    threads: int = 1
    min_gain_share: float = SearchLimits.MIN_GAIN  # of the gap's energy that each further effect must explain

    def grow(self, alone: Sequence[EffectFit], progress: Progress) -> EffectFit | None:
        """Return the best composition, None if no single effect gains more than its error."""
        beam, residual = list(alone[:BEAM]), self.baseline_residual
        best = next(iter(beam), None)
        if best and not is_worthwhile(self.evidence, residual, best, prior_cost(best, self.energy)):
            best = None
        for size in range(2, SearchLimits.MAX_EFFECTS + 1):
            left = np.inf if best is None else best.cost - len(residual)
            enough = left < self.min_gain_share * self.energy
            if best is None or (enough and prior_cost(best, self.energy) == 0.0):
                break
            progress(f"trying {size} effects together", (size - 1) / SearchLimits.MAX_EFFECTS)
            limit = best.cost
            joint = sorted((f for f in self._fit_additions(beam) if f.cost < limit), key=lambda f: f.cost)
            beam = [self.refinement.refine(self.evidence, fit) for fit in joint[:BEAM]]
            better = choose_best_fit(self.evidence, [best, *beam], self.energy)
            is_closer = better.cost - len(residual) <= VerdictLimits.HALF * left
            if not self._is_necessary(better, best) or (enough and not is_closer):  # a map absorbs a part of anything
                break
            best = better
        return best

    def improve(
        self, best: EffectFit, tried: tuple[EffectFit, ...] = (), fixed: Sequence[str] = ()
    ) -> tuple[EffectFit, tuple[EffectFit, ...]]:
        """Return the composition after removals that cost nothing and replacements that leave less; and the fits tried.

        `fixed` effects are not replaced. A composition with a replacement is improved in turn.
        """
        close = self.refinement.anchor(self.evidence, best)
        parts = split_composition(best, self.forms)
        fewer = {name: fit_together(close, [p for p in parts if p.names[0] != name]) for name in best.names}
        for fit in sorted(fewer.values(), key=lambda f: f.cost):
            if self._is_necessary(best, fit):
                continue
            refined = self.refinement.refine(self.evidence, fit)
            if not self._is_necessary(best, refined):
                return self.improve(refined) if len(refined.effects) > 1 else (refined, ())
        for name in [n for n in best.names if n not in fixed]:
            swapped = self._fit_swaps(close, best, fewer[name])
            better = choose_best_fit(self.evidence, [best, *swapped], self.energy)
            if better is not best:
                others = tuple(f for f in swapped if f is not better)
                return self.improve(better, (*tried, *others, best), tuple(set(better.names) - set(best.names)))
            tried = (*tried, *swapped)
        return best, tried

    def _fit_additions(self, beam: Sequence[EffectFit]) -> list[EffectFit]:
        """Return each fit in the beam refitted with its most promising additions, no composition twice."""
        jobs: dict[frozenset[str], tuple[Evidence, list[EffectFit]]] = {}
        for fit in beam:
            close = self.refinement.anchor(self.evidence, fit)
            for other in rank_additions(fit, self.forms, self.baseline_residual)[:MAX_ADDITIONS]:
                parts = [*split_composition(fit, self.forms), other]
                jobs.setdefault(frozenset((*fit.names, *other.names)), (close, parts))
        return fit_each(list(jobs.values()), self.threads)

    def _is_necessary(self, best: EffectFit, fewer: EffectFit) -> bool:
        added = prior_cost(best, self.energy) - prior_cost(fewer, self.energy)
        return is_worthwhile(self.evidence, fewer.left_out, best, self.min_gain_share * self.energy + added)

    def _fit_swaps(self, close: Evidence, best: EffectFit, fewer: EffectFit) -> list[EffectFit]:
        """Return the most promising compositions of `fewer` and an effect that is not in `best`, refined."""
        ranked = rank_additions(fewer, self.forms, self.baseline_residual)
        others = [f for f in ranked if f.names[0] not in best.names][:MAX_SWAPS]
        joint = fit_each([(close, [*split_composition(fewer, self.forms), other]) for other in others], self.threads)
        limit = best.cost + REFINE_SWAPS_WITHIN_SHARE * self.energy
        promising = sorted((f for f in joint if f.cost < limit), key=lambda f: f.cost)
        return [self.refinement.refine(self.evidence, fit) for fit in promising[:MAX_REFINED_SWAPS]]


def find_alternatives(result: EffectSearchResult) -> list[EffectFit]:
    """Return the fits that differ from the best in one effect."""
    best = result.best
    if best is None:
        return []
    fits = result.alone if len(best.effects) == 1 else result.tried
    near = [f for f in fits if len(f.names) == len(best.names) and len(set(best.names) - set(f.names)) == 1]
    return [f for f in near if not loses_to_nested_form(result.evidence, f, best, result.gap_energy)]


def min_unexplained_shares(result: EffectSearchResult) -> dict[str, float]:
    """Return the smallest share of the gap's energy that each effect leaves: alone, in the best, or as an alternative.

    The simulation's timing counts if it alone is the best. An alternative counts only for the effect that it adds, not
    for those that it shares with the best. An effect that loses to a nested form explains what that form explains: it
    counts as leaving the whole gap.
    """
    best, energy = result.best, result.gap_energy
    whole = len(result.baseline_residual) + energy
    alone = () if best is None or len(best.names) > 1 else best.names
    fits = [fit for fit in result.alone if fit.names[0] in alone or not fit.effects[0].nuisance]
    costs = {fit.names[0]: fit.cost + prior_cost(fit, energy) for fit in fits}
    if best is not None and len(best.effects) == 1:
        lost = [f for f in result.alone if loses_to_nested_form(result.evidence, f, best, energy)]
        costs.update({f.names[0]: max(f.cost, whole) for f in lost})
    for fit in (*find_alternatives(result), *([best] if best is not None else [])):
        names = fit.names if best is None or fit is best else set(fit.names) - set(best.names)
        costs.update({name: min(costs[name], fit.cost + prior_cost(fit, energy)) for name in names if name in costs})
    return {name: (cost - len(result.baseline_residual)) / energy for name, cost in costs.items()}


def interchangeable_effects(
    result: EffectSearchResult, allowance: Callable[[EffectFit], float] = lambda fit: 0.0
) -> tuple[tuple[str, ...], ...]:
    """Return groups: an effect of the best composition, followed by those that can replace it, best first.

    The simulation's timing and a map of its calibration replace nothing; beside an effect the timing is not replaced.
    The `allowance` of a fit is the whitened energy that it may leave because of the twin's error.
    """
    best = result.best
    groups: dict[str, list[str]] = {}
    if best is None:
        return ()
    for fit in sorted(find_alternatives(result), key=lambda f: f.cost):
        (member,) = set(best.names) - set(fit.names)
        (other,) = set(fit.names) - set(best.names)
        (added,) = (e for e in fit.effects if e.name == other)
        timed = len(best.effects) > 1 and any(e.name == member and e.nuisance for e in best.effects)
        allowed = not (timed or added.nuisance or added.prior_share > 0.0)
        if allowed and _is_as_good(result, best, fit, allowance(fit)):
            groups.setdefault(member, [member]).append(other)
    return tuple(tuple(dict.fromkeys(groups[name])) for name in best.names if name in groups)


def _is_as_good(result: EffectSearchResult, best: EffectFit, fit: EffectFit, allowance: float) -> bool:
    """True if the best gains a negligible energy over the fit, or a small one that is within twice its error.

    A gain within the fit's `allowance` counts as none.

    At one current, a wrong gain of current or of force differ by how the simulation depends on the current only. These
    recordings do not verify that, so a somewhat larger gain does not decide between the two.
    """
    paired = compute_paired_gain(result.evidence, fit.left_out, best.left_out)
    share = (paired.energy - allowance) / result.gap_energy
    if set(best.names) ^ set(fit.names) == ALIKE_AT_CONSTANT_CURRENT and is_current_constant(result.evidence.traces):
        return share < VerdictLimits.TENTH
    return share < SearchLimits.NEGLIGIBLE or (share < SearchLimits.MIN_GAIN and paired.z < EvidenceLimits.MIN_GAIN_Z)


def find_absorbed_effects(result: EffectSearchResult) -> tuple[str, ...]:
    """Return the effects whose signatures lie mostly inside the calibration's map; none with references."""
    maps = [f for f in result.alone if f.effects[0] in CALIBRATION_FORMS]
    if not maps:
        return ()
    scale = np.linalg.norm(maps[0].jacobian, axis=0)
    tangents = maps[0].jacobian[:, scale > 0.0] / scale[scale > 0.0]

    def is_inside(signature: F) -> bool:
        outside = signature - tangents @ np.linalg.lstsq(tangents, signature, rcond=None)[0]
        return bool(outside @ outside < (1.0 - SearchLimits.MIN_ABSORBED) * (signature @ signature))

    others = [f for f in result.alone if f not in maps]
    return tuple(f.names[0] for f in others if is_inside(result.baseline_residual - f.residual))
