"""What was withheld in a case beside what the diagnosis said of it: one record, from which every figure is counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

NONE, UNKNOWN = "none", "unknown"  # the candidates beside the effects
SURE_PROBABILITY = 0.9  # probability from which a wrong name is called confidently wrong


@dataclass(frozen=True)
class CaseOutcome:
    """A case: what it is (sealed), what was said (`gap.json`), and how far the gap truly shrank (`Closure`, if any).

    `ranked` are the causes, most probable first; `probability` by candidate, with `none` and `unknown`; `composition`
    are the effects of the composition; `indistinguishable` are classes that the diagnosis declared indistinguishable.
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
        """The candidate that is right: an effect's name, `none` or `unknown`; for a pair both names."""
        return {NONE: NONE, "outside": UNKNOWN}.get(self.kind, " + ".join(self.truth))

    def is_in_top(self, count: int) -> bool:
        """True if the withheld effect is among the first so many causes."""
        return bool(set(self.truth) & set(self.ranked[:count]))

    def is_first_by_class(self) -> bool:
        """True if the first cause is the withheld effect or was declared indistinguishable from it."""
        return bool(self.ranked) and any(self.is_same_class(self.ranked[0], name) for name in self.truth)

    def is_same_class(self, a: str, b: str) -> bool:
        """True if two names are equal or of one class."""
        return a == b or any({a, b} <= group for group in self.indistinguishable)

    def names_exactly(self) -> bool:
        """True if exactly the withheld effects were named."""
        return self.verdict == "named" and set(self.composition) == set(self.truth)

    def finds_exactly(self) -> bool:
        """True if the composition is exactly what was withheld."""
        return set(self.composition) == set(self.truth) and len(self.composition) == len(self.truth)

    def finds_by_class(self) -> bool:
        """True if found and withheld effects can be matched one to one, each equal or indistinguishable."""
        return len(self.composition) == len(self.truth) and _can_match(self.truth, self.composition, self)

    def is_confidently_wrong(self) -> bool:
        """True if a cause was named with a probability of at least 0.9 and is not what was withheld."""
        first = self.ranked[0] if self.ranked else ""
        return (
            self.verdict == "named" and self.probability.get(first, 0.0) >= SURE_PROBABILITY and first not in self.truth
        )


def build_case_outcome(
    label: Mapping[str, Any],
    gap: Mapping[str, Any],
    figures: Mapping[str, float],
    baselines: Mapping[str, str],
    seconds: float,
) -> CaseOutcome:
    """Return the record of a case from its label, its `gap.json`, and what simpler ways would have named."""
    causes = gap["causes"]
    rest = gap["probabilities"]
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


def _can_match(truth: Sequence[str], found: Sequence[str], by: CaseOutcome) -> bool:
    if not truth:
        return True
    return any(
        by.is_same_class(truth[0], name) and _can_match(truth[1:], [*found[:i], *found[i + 1 :]], by)
        for i, name in enumerate(found)
    )
