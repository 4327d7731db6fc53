"""One record per case: the withheld effects and the result of the diagnosis, from which all metrics are computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import permutations
from typing import Any

from ces_cli.blind.coverage import list_coverage
from ces_cli.blind.mode import IDENTIFIED, Mode

NONE, UNKNOWN = "none", "unknown"  # candidates besides the effects
CALIBRATION = "calibration"  # the cause "the simulation's force map is off"
SURE_PROBABILITY = 0.9  # from here on a wrong cause counts as confidently wrong


@dataclass(frozen=True)
class CaseOutcome:
    """A case: its sealed description, its diagnosis (`gap.json`) and the true figures from the sealed arrays.

    `ranked` are the causes, most probable first; `probability` is by candidate, with `none` and `unknown`;
    `composition` names the effects; `indistinguishable` are groups that the diagnosis reported; `covered` says for each
    comparable parameter whether its interval contains the truth.
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
    mode: Mode = field(default_factory=Mode)
    gap_N: float = 0.0
    covered: tuple[bool, ...] = ()

    @property
    def is_simulation_wrong(self) -> bool:
        """Whether the simulation has an error of its own, as an identified model always has."""
        return self.baseline_ratio > 0.0 or self.mode.simulation == IDENTIFIED

    @property
    def is_error_in_gap(self) -> bool:
        """Whether that error is a part of the gap, because there are no references that show it."""
        return self.is_simulation_wrong and self.mode.references == 0

    @property
    def answer(self) -> str:
        """The right candidate: an effect's name, `none` or `unknown`; for a pair both names."""
        return {NONE: NONE, "outside": UNKNOWN}.get(self.kind, " + ".join(self.truth))

    @property
    def accepted(self) -> frozenset[str]:
        """The candidates that are right; several if nothing is withheld but the simulation's error is in the gap."""
        if self.kind == NONE and self.is_error_in_gap:
            return frozenset({NONE, UNKNOWN, CALIBRATION})
        return frozenset({self.answer})

    @property
    def found(self) -> tuple[str, ...]:
        """The composition without `calibration` where that is true, too, beside a withheld effect."""
        extra = {CALIBRATION} if self.is_simulation_wrong and set(self.truth) & set(self.composition) else set()
        return tuple(name for name in self.composition if name not in extra)

    def is_in_top(self, count: int) -> bool:
        """Return whether a withheld effect is among the first `count` causes."""
        return bool(set(self.truth) & set(self.ranked[:count]))

    def is_first_effect(self) -> bool:
        """Return whether a withheld effect comes first, `calibration` left out where the simulation is wrong."""
        ranked = [name for name in self.ranked if not (name == CALIBRATION and self.is_simulation_wrong)]
        return bool(set(self.truth) & set(ranked[:1]))

    def is_named_wrongly(self) -> bool:
        """Return whether the verdict is `named` with an effect that was not withheld."""
        return self.verdict == "named" and not set(self.found) <= set(self.truth)

    def is_false_alarm(self) -> bool:
        """Return whether a cause is claimed although nothing was withheld.

        Where the simulation's own error is in the gap, `unknown` and `calibration` alone are right, too.
        """
        if self.is_error_in_gap:
            return self.verdict not in ("no_gap", UNKNOWN) and self.composition != (CALIBRATION,)
        return self.verdict != "no_gap"

    def is_first_by_class(self) -> bool:
        """Return whether the first cause is a withheld effect or was reported as indistinguishable from it."""
        return bool(self.ranked) and any(self.is_same_class(self.ranked[0], name) for name in self.truth)

    def is_same_class(self, a: str, b: str) -> bool:
        """Return whether two names are equal or in one group."""
        return a == b or any({a, b} <= group for group in self.indistinguishable)

    def names_exactly(self) -> bool:
        """Return whether the verdict names exactly the withheld effects."""
        return self.verdict == "named" and set(self.found) == set(self.truth)

    def finds_exactly(self) -> bool:
        """Return whether the composition is exactly the withheld effects."""
        return sorted(self.found) == sorted(self.truth)

    def finds_by_class(self) -> bool:
        """Return whether composition and withheld effects match one to one, each equal or indistinguishable."""
        return len(self.found) == len(self.truth) and any(
            all(map(self.is_same_class, self.truth, order)) for order in permutations(self.found)
        )

    def is_confidently_wrong(self) -> bool:
        """Return whether a cause that was not withheld was named with a probability of at least 0.9."""
        first = self.ranked[0] if self.ranked else ""
        is_sure = self.probability.get(first, 0.0) >= SURE_PROBABILITY
        return self.verdict == "named" and is_sure and first not in self.accepted | set(self.truth)


def build_case_outcome(
    label: Mapping[str, Any],
    gap: Mapping[str, Any],
    figures: Mapping[str, float],
    baselines: Mapping[str, str],
    seconds: float,
    mode: Mode,
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
        mode=mode,
        gap_N=label["gap_N"],
        covered=list_coverage(label, gap),
    )
