"""Which explanation of a gap: parameters of the simulation, a missing effect, or both; and those that do as well.

All parameters are freed at once, alone and beside each promising effect. What is needed is then chosen on the tangents
there, and refitted: every further parameter, of the simulation or of an effect, must explain its share of the gap's
energy on units left out, and what leaves about as little with fewer is an alternative. Bayesian criteria name too much:
no law is exactly true.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ces_data.arrays import F
from ces_gap.calibrate.fitting import ParameterFit, find_loose
from ces_gap.calibrate.parameters import size_of
from ces_gap.effects.effect import Effect
from ces_gap.inference.fit import EffectFit, fit_from, fit_promising, fit_to_the_end, linearise
from ces_gap.inference.rare import find_rare_deviation
from ces_gap.limits import EvidenceLimits, ParameterLimits, SearchLimits, VerdictLimits
from ces_gap.progress import Progress, ignore_progress

CANDIDATES = 3  # effects that are tried beside the parameters: of the best without and of the best beside them
MAX_SETS = 2000  # of one size; of very many parameters fewer are freed together
MAX_REFITS = 8  # hypotheses that are refitted, best first
MAX_ALIKE = 3  # more of them, which leave as little with no more causes
REFIT_SHARE = 0.1  # of the gap's energy by which one that is refitted may leave more on the tangents than the best


@dataclass(frozen=True)
class Hypothesis:
    """The parameters of the simulation at `places` and at most one effect as the explanation of a gap.

    `left` is the whitened energy on the units left out; `fit` is None if nothing is freed.
    """

    places: tuple[int, ...]
    effect: Effect | None
    fit: EffectFit | None
    left: float

    @property
    def members(self) -> frozenset[object]:
        """What it consists of."""
        return frozenset((*self.places, *([] if self.effect is None else [self.effect.name])))

    def cost(self, energy: float) -> float:
        """Return the energy left and the price of each parameter in a gap of this energy."""
        return self.left + SearchLimits.PARAMETER * energy * (0 if self.fit is None else len(self.fit.searched))


@dataclass(frozen=True)
class ChosenExplanation:
    """The best hypothesis, those that do as well, and that of all parameters beside its effect."""

    best: Hypothesis
    alternatives: tuple[Hypothesis, ...]
    whole: Hypothesis


def choose(fitted: ParameterFit, effects: Sequence[Effect], progress: Progress = ignore_progress) -> ChosenExplanation:
    """Return the choice among the parameters that were fitted and the effects."""
    residual, energy = fitted.default_residual, fitted.gap_energy
    nothing = Hypothesis((), None, None, float(residual @ residual))
    if energy <= EvidenceLimits.VISIBLE**2 * len(residual) and not _has_rare_deviation(fitted):
        return ChosenExplanation(nothing, (), _whole(fitted, nothing, fitted.fit))
    alone = fit_promising(fitted.evidence, effects, CANDIDATES, progress)
    all_freed = fitted.beside(fitted.determined, fitted.searched[list(fitted.determined)])
    joints = _fit_beside(fitted, alone, fit_promising(all_freed, effects, CANDIDATES, progress))
    tangents, simple = [_Tangent.at(fitted, j) for j in joints], [nothing, *(_hypothesis(fitted, (), f) for f in alone)]
    best, *others = _refit_best(fitted, tangents, simple, energy, progress)
    rest = best.left - len(residual)
    is_left = rest > EvidenceLimits.VISIBLE**2 * len(residual) or _has_rare_deviation(fitted, best)
    if is_left:  # and small beside the first gap
        rest = max(rest, ParameterLimits.SAME_ENERGY / SearchLimits.PARAMETER)
        again, *ties = _refit_best(fitted, tangents, simple, rest, progress)
        if again.left - len(residual) < VerdictLimits.HALF * rest:
            best, others, energy = again, ties, rest
    instead = _replace_parameters(fitted, best, effects, progress) if best.effect is None else []
    best, *others = _choose_minimal([_finish(fitted, h) for h in (best, *others, *instead)], energy, len(residual))
    whole = next((j for j in joints if _effect_of(fitted, j) == best.effect), fitted.fit)
    return ChosenExplanation(best, tuple(others), _whole(fitted, best, whole))


def _has_rare_deviation(fitted: ParameterFit, h: Hypothesis | None = None) -> bool:
    """Return whether a short deviation stands out from the simulation, or from a hypothesis."""
    forces = fitted.evidence.forces(h.fit.composition) if h is not None and h.fit is not None else fitted.evidence.alone
    return find_rare_deviation(fitted.evidence.traces, forces) is not None


def _refit_best(
    fitted: ParameterFit,
    tangents: Sequence[_Tangent],
    simple: Sequence[Hypothesis],
    energy: float,
    progress: Progress = ignore_progress,
) -> list[Hypothesis]:
    """Return the best hypothesis and its alternatives; a parameter costs its share of a gap of this energy."""
    drafts = _without_needless([d for tangent in tangents for d in tangent.drafts(SearchLimits.PARAMETER * energy)])
    best, noise = drafts[0], len(fitted.default_residual)
    close = [d for d in drafts if d.cost < best.cost + REFIT_SHARE * energy][:MAX_REFITS]
    alike = [d for d in drafts if d.left < best.left + noise and len(d.members) <= len(best.members)]
    close += [d for d in alike if d not in close][:MAX_ALIKE]
    refitted = []
    for k, draft in enumerate(close):
        progress("refitting explanations", k / len(close))
        refitted.append(
            _hypothesis(fitted, draft.places, fit_from(fitted.evidence, draft.effects(fitted), draft.start))
        )
    return _choose_minimal([*simple, *refitted], energy, noise)


def _replace_parameters(
    fitted: ParameterFit, best: Hypothesis, effects: Sequence[Effect], progress: Progress
) -> list[Hypothesis]:
    """Return the hypotheses with an effect in the place of each parameter of the best one."""
    instead = []
    for k in range(len(best.places) if best.fit is not None else 0):
        places, at = best.places[:k] + best.places[k + 1 :], np.delete(best.fit.searched, k)  # type: ignore[union-attr]
        for f in fit_promising(fitted.beside(places, at), effects, 1, progress):
            start = np.concatenate([at, f.searched])
            instead.append(
                _hypothesis(
                    fitted, places, fit_from(fitted.evidence, fitted.beside_effect(f.effects[0], places), start)
                )
            )
    return instead


def _hypothesis(fitted: ParameterFit, places: tuple[int, ...], fit: EffectFit) -> Hypothesis:
    return Hypothesis(places, _effect_of(fitted, fit), fit, fit.cost)


def _finish(fitted: ParameterFit, h: Hypothesis, kept: Sequence[int] = ()) -> Hypothesis:
    """Return the hypothesis with its fit continued to the end, without what is not determined beside the rest of it.

    Parameters at the places that are `kept` stay all the same.
    """
    if h.fit is None:
        return h
    fit = fit_to_the_end(fitted.evidence, h.fit.effects, h.fit.searched)
    loose = [i for i in find_loose(fitted, h.places, fit) if h.places[i] not in kept]
    if not loose:
        return _hypothesis(fitted, h.places, fit)
    places, start = tuple(np.delete(h.places, loose).tolist()), np.delete(fit.searched, loose)
    if not len(start):
        residual = fitted.default_residual
        return Hypothesis((), None, None, float(residual @ residual))
    again = fit_from(fitted.evidence, fitted.beside_effect(h.effect, places), start)
    return _finish(fitted, _hypothesis(fitted, places, again), kept)


def _whole(fitted: ParameterFit, best: Hypothesis, fit: EffectFit | None) -> Hypothesis:
    """Return the hypothesis of all parameters that are determined beside each other and the best one's effect."""
    return _finish(fitted, Hypothesis(fitted.determined if fitted.fit else (), best.effect, fit, 0.0), best.places)


def _effect_of(fitted: ParameterFit, fit: EffectFit) -> Effect | None:
    """Return the effect of a fit, None if it has parameters of the simulation alone."""
    return None if fit.effects[-1].name == fitted.effect.name else fit.effects[-1]


def _fit_beside(fitted: ParameterFit, alone: Sequence[EffectFit], beside: Sequence[EffectFit]) -> list[EffectFit]:
    """Return the fits of all parameters without an effect, and with each of those that promise most."""
    if fitted.fit is None:
        return list(alone)
    start = fitted.start[list(fitted.determined)]
    starts = {(f.names, f.effects[0].form): np.concatenate([start, f.searched]) for f in alone}
    starts |= {(f.names, f.effects[0].form): np.concatenate([fitted.fit.searched, f.searched]) for f in beside}
    effects = {(f.names, f.effects[0].form): f.effects[0] for f in (*alone, *beside)}
    return [fitted.fit, *(fit_from(fitted.evidence, fitted.beside_effect(effects[k]), at) for k, at in starts.items())]


@dataclass(frozen=True, eq=False)
class _Draft:
    """A hypothesis on the tangents: what it leaves, its cost with prices, and the values from which it is refitted."""

    places: tuple[int, ...]
    effect: Effect | None
    left: float
    cost: float
    start: F

    def effects(self, fitted: ParameterFit) -> tuple[Effect, ...]:
        return fitted.beside_effect(self.effect, self.places)

    @property
    def members(self) -> frozenset[object]:
        return frozenset((*self.places, *([] if self.effect is None else [self.effect.name])))


@dataclass(frozen=True)
class _Tangent:
    """The energy left around a fit as a quadratic function of all parameters and those of its effect."""

    fitted: ParameterFit
    effect: Effect | None
    searched: F  # (p + q,)
    energy: float
    gram: F
    slope: F

    @classmethod
    def at(cls, fitted: ParameterFit, joint: EffectFit) -> _Tangent:
        effect, count = _effect_of(fitted, joint), len(fitted.determined) if fitted.fit is not None else 0
        at = fitted.start
        at[list(fitted.determined)] = joint.searched[:count]
        searched = np.concatenate([at, joint.searched[count:]])
        every = range(len(fitted.effect.free))
        residual, jacobian = joint.residual, joint.jacobian
        if count < len(every):
            residual, jacobian = linearise(fitted.evidence, fitted.beside_effect(effect, every), searched)
        return cls(fitted, effect, searched, float(residual @ residual), jacobian.T @ jacobian, jacobian.T @ residual)

    def drafts(self, price: float) -> list[_Draft]:
        """Return every hypothesis of this effect and a few parameters, or all, that the data determine together."""
        count = len(self.fitted.effect.free)
        few: list[tuple[int, ...]] = []
        for size in range(min(ParameterLimits.MAX_FREED, count) + 1):
            few += combinations(range(count), size) if math.comb(count, size) <= MAX_SETS else ()
        drafts = [self._draft(places, price) for places in dict.fromkeys((*few, self.fitted.determined))]
        return [draft for draft in drafts if draft is not None]

    def _draft(self, places: tuple[int, ...], price: float) -> _Draft | None:
        """Return the hypothesis with the other parameters at their defaults; None if it is not determined."""
        count = len(self.fitted.effect.free)
        free = [*places, *range(count, len(self.searched))]
        held = [k for k in range(count) if k not in places]
        if not free:
            return None
        back = self.fitted.start[held] - self.searched[held]
        block, right = self.gram[np.ix_(free, free)], self.slope[free] - self.gram[np.ix_(free, held)] @ back
        size = np.sqrt(np.maximum(np.diag(block), 1e-300))
        inverse = np.linalg.pinv(block / np.outer(size, size), rcond=1e-10, hermitian=True) / np.outer(size, size)
        sizes = np.array([size_of(self.fitted.effect.free[k]) for k in places])
        if (EvidenceLimits.SURE * np.sqrt(np.diag(inverse)[: len(places)]) > sizes).any():
            return None
        moved = inverse @ right
        returned = float(back @ self.gram[np.ix_(held, held)] @ back - 2.0 * self.slope[held] @ back)
        left = self.energy + returned - float(right @ moved)
        return _Draft(places, self.effect, left, left + price * len(free), self.searched[free] + moved)


def _without_needless(drafts: Sequence[_Draft]) -> list[_Draft]:
    """Return the drafts, best first, without those that a part of them explains as well."""
    kept: list[_Draft] = []
    for draft in sorted(drafts, key=lambda d: d.cost):
        if not any(other.members <= draft.members for other in kept):
            kept.append(draft)
    return kept


def _choose_minimal(hypotheses: Sequence[Hypothesis], energy: float, noise: float) -> list[Hypothesis]:
    """Return the best hypothesis and those that do about as well; none of which another is a part.

    As well does what leaves as little, to a share of the gap's energy and to that of the `noise`, with no more causes,
    however many numbers an effect has. An effect that does the same as a parameter, such as a gas spring beside a gas
    rate, is that parameter.
    """
    ranked = sorted(hypotheses, key=lambda h: h.cost(energy))
    best, margin = ranked[0], min(SearchLimits.NEGLIGIBLE * energy, noise)
    close = [
        h
        for h in ranked
        if h.cost(energy) <= best.cost(energy) + margin
        or (h.left <= best.left + margin and len(h.members) <= len(best.members))
    ]
    minimal = [h for h in close if not any(other.members < h.members for other in close)]
    without = [h.left for h in minimal if h.effect is None]
    minimal = [
        h for h in minimal if h.effect is None or all(abs(h.left - o) > ParameterLimits.SAME_ENERGY for o in without)
    ]
    seen: dict[frozenset[object], Hypothesis] = {}
    for h in minimal:
        seen.setdefault(h.members, h)
    return list(seen.values())
