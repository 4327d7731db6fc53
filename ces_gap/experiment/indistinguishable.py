"""Twins: effects that these very recordings could not tell apart, however the parameters of one are set.

Half the square of the distance from A, at its fitted values, to B is the expected log-likelihood ratio between A and B
if A is true. The whitening drops what the baseline's own error could absorb, so that this is not counted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition, Setting
from ces_gap.experiment.matching import Match, nearest, refine_match
from ces_gap.experiment.signatures import NONE, Probe, Tangent, Whiten, sample_tangents
from ces_gap.inference.evidence import Evidence
from ces_gap.trace import Trace

F = NDArray[np.float64]

FORM = 0.15  # of a signature's size: as far as real physics is from an effect's form anyway
EVIDENCE = 3.0  # expected log-likelihood ratio below which data cannot tell: odds of 20 to 1, wrong 1 time in 9
NEAR, ALIKE = 5.0, 0.3  # times the limit, times the smaller effect: linear distances above both are not refined
MAX_REFINED_PAIRS = 8  # pairs, the nearest first


@dataclass(frozen=True)
class IndistinguishableEffects:
    """What can be told apart. `matches` by (A, B): how near B comes to A; `evidence` is the limit.

    `classes` are groups in which every one can stand for every other. `silent` effects are so small at their fitted
    values that the data could not tell them from none; they are in no class.
    """

    matches: Mapping[tuple[str, str], Match]
    classes: tuple[tuple[str, ...], ...]
    silent: tuple[str, ...]
    evidence: float = EVIDENCE

    def clearest_match(self, a: str, b: str) -> Match:
        """Return the match of two effects in the direction that tells them apart better."""
        return max(self.matches[a, b], self.matches[b, a], key=lambda m: m.index)

    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Return the pairs of twins, the nearest first."""
        inside = [pair for group in self.classes for pair in combinations(group, 2)]
        return tuple(sorted(inside, key=lambda pair: self.clearest_match(*pair).index))


def find_indistinguishable_effects(
    plant: Plant,
    traces: Sequence[Trace],
    fitted: Sequence[Setting],
    whiten: Whiten,
    evidence: float = EVIDENCE,
    around: Composition = NONE,
) -> IndistinguishableEffects:
    """Return which of the fitted effects are twins on these traces.

    `fitted` may hold several forms of an effect: the first stands for it when others try to match it, all are tried
    when it tries to match others. `evidence` is the expected log-likelihood ratio below which two are twins,
    and an effect is not told from none; at 3 the wrong one of two fits better with probability Φ(−√6/2) = 11 %. Two
    are twins as well within `FORM` of the signature's size, because forms are no more exact than that. `around` are
    effects that are there besides, none of them in `fitted`.
    """
    probe = Probe(plant, traces, whiten, around)
    fans = _tangents_by_effect(probe, fitted)
    silent = tuple(name for name, tangents_ in fans.items() if tangents_[0].size ** 2 / 2.0 < evidence)
    heard = [name for name in fans if name not in silent]
    matches = {(a, b): nearest(fans[a][0], fans[b]) for a, b in permutations(heard, 2)}
    for a, b in _pairs_to_refine({name: fans[name][0].size for name in heard}, matches, evidence):
        matches[a, b] = refine_match(fans[a][0], fans[b], probe.tangent)
    limit = np.sqrt(2.0 * evidence)
    index = {(a, b): m.index / max(1.0, FORM * fans[a][0].size / limit) for (a, b), m in matches.items()}
    return IndistinguishableEffects(matches, group_effects(heard, index, evidence), silent, evidence)


def make_evidence_whitening(evidence: Evidence) -> Whiten:
    """Return the whitening of the evidence's own units, for signatures on its traces."""

    def whiten(trace: int, force: F) -> F:
        return np.concatenate([u.whiten(evidence.noise, force) for u in evidence.units if u.trace == trace])

    return whiten


def group_effects(
    names: Sequence[str], index: Mapping[tuple[str, str], float], evidence: float = EVIDENCE
) -> tuple[tuple[str, ...], ...]:
    """Return the groups of at least two names in which all pairs, both ways, are within the limit.

    Complete linkage: groups grow by joining the two whose farthest members are nearest, so that a chain of neighbours
    does not make one class of effects that can be told apart.
    """
    groups: list[tuple[str, ...]] = [(name,) for name in names]
    limit = np.sqrt(2.0 * evidence)

    def width(pair: tuple[tuple[str, ...], tuple[str, ...]]) -> float:
        return max(max(index[a, b], index[b, a]) for a in pair[0] for b in pair[1])

    while len(groups) > 1:
        one, other = min(combinations(groups, 2), key=width)
        if width((one, other)) >= limit:
            break
        groups = [g for g in groups if g not in (one, other)] + [one + other]
    order = {name: k for k, name in enumerate(names)}
    large = [tuple(sorted(g, key=order.__getitem__)) for g in groups if len(g) > 1]
    return tuple(sorted(large, key=lambda g: order[g[0]]))


def _tangents_by_effect(probe: Probe, fitted: Sequence[Setting]) -> dict[str, list[Tangent]]:
    at = [probe.tangent(setting) for setting in fitted]
    size = max((tangent.size for tangent in at), default=0.0)
    fans: dict[str, list[Tangent]] = {}
    for tangent in at:
        fans.setdefault(tangent.setting.name, []).extend(sample_tangents(probe, tangent, size))
    return fans


def _pairs_to_refine(
    size: Mapping[str, float], matches: Mapping[tuple[str, str], Match], evidence: float
) -> list[tuple[str, str]]:
    """Return the ordered pairs to be refined: both ways near the limit or alike, nearest first."""
    near = NEAR * np.sqrt(2.0 * evidence)
    far = {(a, b): max(matches[a, b].index, matches[b, a].index) for a, b in combinations(size, 2)}
    close = [(a, b) for a, b in far if far[a, b] < max(near, ALIKE * min(size[a], size[b]))]
    close = sorted(close, key=far.__getitem__)[:MAX_REFINED_PAIRS]
    return [ordered for a, b in close for ordered in ((a, b), (b, a))]
