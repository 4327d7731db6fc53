"""Indistinguishable effects: those that give the same force on these recordings, once their parameters are refitted.

Half the square of the distance from A, at its fitted values, to B is the expected log-likelihood ratio between A and B
if A is true. The whitening removes differences that the uncertain baseline error could absorb.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition, Setting
from ces_gap.experiment.matching import Match, find_nearest, refine_match
from ces_gap.experiment.signatures import NONE, Probe, Tangent, Whiten, sample_tangents
from ces_gap.inference.evidence import Evidence
from ces_gap.trace import F, Trace

FORM = 0.15  # of a signature's size: the error of a form compared with real physics
EVIDENCE = 3.0  # minimum expected log-likelihood ratio: odds of 20 to 1; the wrong effect fits better 1 time in 9
NEAR, ALIKE = 5.0, 0.3  # times the limit, times the smaller effect: linear distances above both are not refined
MAX_REFINED_PAIRS = 8  # the nearest pairs

LIMIT = np.sqrt(2.0 * EVIDENCE)  # the same as a distance


@dataclass(frozen=True)
class IndistinguishableEffects:
    """Which effects the recordings can distinguish; `matches` by (A, B) say how near B comes to A.

    In each of the `classes`, every effect can replace every other. `silent` effects are so small at their fitted values
    that the data cannot detect them; they are in no class.
    """

    matches: Mapping[tuple[str, str], Match]
    classes: tuple[tuple[str, ...], ...]
    silent: tuple[str, ...]

    def clearest_match(self, a: str, b: str) -> Match:
        """Return the match of two effects in the direction that distinguishes them better."""
        return max(self.matches[a, b], self.matches[b, a], key=lambda m: m.index)

    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Return the pairs of indistinguishable effects, the nearest first."""
        inside = [pair for group in self.classes for pair in combinations(group, 2)]
        return tuple(sorted(inside, key=lambda pair: self.clearest_match(*pair).index))


def find_indistinguishable_effects(
    plant: Plant,
    traces: Sequence[Trace],
    fitted: Sequence[Setting],
    whiten: Whiten,
    around: Composition = NONE,
) -> IndistinguishableEffects:
    """Return which of the fitted effects are indistinguishable on these traces.

    `fitted` may hold several forms of an effect: others must match the first, and each may match others. Two effects
    are indistinguishable if the expected log-likelihood ratio is below `EVIDENCE`, where the wrong one fits better with
    probability Φ(−√6/2) = 11 %, or if they differ by less than `FORM` of the signature, because forms are not more
    accurate. `around` are further effects that are present, none of them in `fitted`.
    """
    probe = Probe(plant, traces, whiten, around)
    fans = _tangents_by_effect(probe, fitted)
    silent = tuple(name for name, fan in fans.items() if fan[0].size ** 2 / 2.0 < EVIDENCE)
    visible = [name for name in fans if name not in silent]
    matches = {(a, b): find_nearest(fans[a][0], fans[b]) for a, b in permutations(visible, 2)}
    for a, b in _pairs_to_refine({name: fans[name][0].size for name in visible}, matches):
        matches[a, b] = refine_match(fans[a][0], fans[b], probe.tangent)
    index = {(a, b): m.index / max(1.0, FORM * fans[a][0].size / LIMIT) for (a, b), m in matches.items()}
    return IndistinguishableEffects(matches, group_effects(visible, index), silent)


def make_evidence_whitening(evidence: Evidence) -> Whiten:
    """Return the whitening of the evidence's own units, for signatures on its traces."""

    def whiten(trace: int, force: F) -> F:
        return np.concatenate([u.whiten(evidence.noise, force) for u in evidence.units if u.trace == trace])

    return whiten


def group_effects(names: Sequence[str], index: Mapping[tuple[str, str], float]) -> tuple[tuple[str, ...], ...]:
    """Return the groups of at least two names in which all pairs, in both directions, are within the limit.

    Complete linkage merges the two groups whose farthest members are nearest, so that a chain of neighbours does not
    become one class of effects that the data can distinguish.
    """
    groups: list[tuple[str, ...]] = [(name,) for name in names]

    def width(pair: tuple[tuple[str, ...], tuple[str, ...]]) -> float:
        return max(max(index[a, b], index[b, a]) for a in pair[0] for b in pair[1])

    while len(groups) > 1:
        one, other = min(combinations(groups, 2), key=width)
        if width((one, other)) >= LIMIT:
            break
        groups = [g for g in groups if g not in (one, other)] + [one + other]
    order = {name: k for k, name in enumerate(names)}
    large = [tuple(sorted(g, key=order.__getitem__)) for g in groups if len(g) > 1]
    return tuple(sorted(large, key=lambda g: order[g[0]]))


def _tangents_by_effect(probe: Probe, fitted: Sequence[Setting]) -> dict[str, list[Tangent]]:
    tangents = [probe.tangent(setting) for setting in fitted]
    size = max((tangent.size for tangent in tangents), default=0.0)
    fans: dict[str, list[Tangent]] = {}
    for tangent in tangents:
        fans.setdefault(tangent.setting.name, []).extend(sample_tangents(probe, tangent, size))
    return fans


def _pairs_to_refine(size: Mapping[str, float], matches: Mapping[tuple[str, str], Match]) -> list[tuple[str, str]]:
    """Return the ordered pairs to be refined: those near the limit or alike in both directions, nearest first."""
    far = {(a, b): max(matches[a, b].index, matches[b, a].index) for a, b in combinations(size, 2)}
    close = [(a, b) for a, b in far if far[a, b] < max(NEAR * LIMIT, ALIKE * min(size[a], size[b]))]
    close = sorted(close, key=far.__getitem__)[:MAX_REFINED_PAIRS]
    return [ordered for a, b in close for ordered in ((a, b), (b, a))]
