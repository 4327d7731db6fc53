"""One record per case: the withheld effects and the result of the diagnosis, from which all metrics are computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import permutations
from typing import Any

NONE, UNKNOWN = "none", "unknown"  # candidates besides the effects
SURE_PROBABILITY = 0.9  # from here on a wrong cause counts as confidently wrong


@dataclass(frozen=True)
class CaseOutcome:
    """A case: its sealed description, its diagnosis (`gap.json`) and the true figures from the sealed arrays.

    `ranked` are the causes, most probable first; `probability` is by candidate, with `none` and `unknown`;
    `composition` names the effects; `indistinguishable` are groups that the diagnosis reported.
    """

    case: str
    kind: str
    truth: tuple[str, ...]
    gap_to_noise: float
    baseline_ratio: float
    excitation: str
    plant: str
    verdict: str
    ranked: tuple[str, ...]
    probability: Mapping[str, float]
    composition: tuple[str, ...]
    indistinguishable: tuple[frozenset[str], ...]
    claimed_shrink: float | None = None
    figures: Mapping[str, float] = field(default_factory=dict)
    baselines: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def answer(self) -> str:
        """The right candidate: an effect's name, `none` or `unknown`; for a pair both names."""
        return {NONE: NONE, "outside": UNKNOWN}.get(self.kind, " + ".join(self.truth))

    def is_in_top(self, count: int) -> bool:
        """Return whether a withheld effect is among the first `count` causes."""
        return bool(set(self.truth) & set(self.ranked[:count]))

    def is_first_by_class(self) -> bool:
        """Return whether the first cause is a withheld effect or was reported as indistinguishable from it."""
        return bool(self.ranked) and any(self.is_same_class(self.ranked[0], name) for name in self.truth)

    def is_same_class(self, a: str, b: str) -> bool:
        """Return whether two names are equal or in one group."""
        return a == b or any({a, b} <= group for group in self.indistinguishable)

    def names_exactly(self) -> bool:
        """Return whether the verdict names exactly the withheld effects."""
        return self.verdict == "named" and set(self.composition) == set(self.truth)

    def finds_exactly(self) -> bool:
        """Return whether the composition is exactly the withheld effects."""
        return sorted(self.composition) == sorted(self.truth)

    def finds_by_class(self) -> bool:
        """Return whether composition and withheld effects match one to one, each equal or indistinguishable."""
        return len(self.composition) == len(self.truth) and any(
            all(map(self.is_same_class, self.truth, order)) for order in permutations(self.composition)
        )

    def is_confidently_wrong(self) -> bool:
        """Return whether a cause that was not withheld was named with a probability of at least 0.9."""
        first = self.ranked[0] if self.ranked else ""
        is_sure = self.probability.get(first, 0.0) >= SURE_PROBABILITY
        return self.verdict == "named" and is_sure and first not in self.truth


def build_case_outcome(
    label: Mapping[str, Any],
    gap: Mapping[str, Any],
    figures: Mapping[str, float],
    baselines: Mapping[str, str],
    seconds: float,
) -> CaseOutcome:
    """Return the record of a case from its label, its `gap.json` and the causes that simpler methods name."""
    causes, rest = gap["causes"], gap["probabilities"]
    return CaseOutcome(
        case=label["case"],
        kind=label["kind"],
        truth=tuple(effect["name"] for effect in label["effects"]),
        gap_to_noise=label["gap_to_noise"],
        baseline_ratio=label["baseline_ratio"],
        excitation=label["excitation"],
        plant=label["plant"],
        verdict=gap["verdict"],
        ranked=tuple(cause["effect"] for cause in causes),
        probability={**{c["effect"]: c["probability"] for c in causes}, NONE: rest["none"], UNKNOWN: rest["unknown"]},
        composition=tuple(gap["composition"]["effects"]),
        indistinguishable=tuple(frozenset(group) for group in gap["indistinguishable"]),
        claimed_shrink=gap["composition"]["shrink"],
        figures=figures,
        baselines=baselines,
        seconds=seconds,
    )
