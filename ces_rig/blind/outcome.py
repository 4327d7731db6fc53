"""The outcome of one blind case: the withheld effects and what the diagnosis said, from which all metrics are computed.

A `Mode` is how the blind test uses the diagnosis: what stands for the simulation, and how many references it gets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

from ces_observer.errors import CesError

RUN, PREDICTIONS, IDENTIFIED = "run", "predictions", "identified"
SIMULATIONS = (RUN, PREDICTIONS, IDENTIFIED)
MAX_REFERENCES = 5  # a case holds no more
CLASSES = ("references", "no_references", "predictions", "identified")
"""Kinds of mode with their own targets and probabilities; the first two run the simulation."""


@dataclass(frozen=True)
class Mode:
    """`simulation` is RUN, PREDICTIONS or IDENTIFIED (a model identified from the references); raises CesError."""

    simulation: str = RUN
    references: int = 2

    def __post_init__(self) -> None:
        if self.simulation not in SIMULATIONS:
            raise CesError(f"--simulation '{self.simulation}': expected one of {', '.join(SIMULATIONS)}")
        if not 0 <= self.references <= MAX_REFERENCES:
            raise CesError(f"--references {self.references}: expected 0 to {MAX_REFERENCES}")
        if self.simulation == IDENTIFIED and self.references == 0:
            raise CesError("--simulation identified: a model is identified from references; add --references 5")

    @property
    def name(self) -> str:
        """The name of the mode's folder of results, such as `run_2`."""
        return f"{self.simulation}_{self.references}"

    @property
    def class_name(self) -> str:
        """The one of CLASSES whose targets apply."""
        if self.simulation != RUN:
            return self.simulation
        return "references" if self.references else "no_references"


def combine_modes(simulations: Sequence[str], references: Sequence[int]) -> list[Mode]:
    """Return the possible modes of both lists, none identified without references; raises CesError if none is."""
    pairs = list(dict.fromkeys(product(simulations, references)))
    possible = [pair for pair in pairs if pair != (IDENTIFIED, 0)]
    return [Mode(*pair) for pair in possible or pairs]


NONE, UNKNOWN = "none", "unknown"  # candidates besides the effects
CALIBRATION = "calibration"  # the cause "the simulation's force map is off"
SAME = ("case", "kind", "plant", "excitation", "gap_to_noise", "baseline_ratio")  # in a label


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
    figures: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    mode: Mode = field(default_factory=Mode)

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

    def finds_exactly(self) -> bool:
        """Return whether the composition is exactly the withheld effects."""
        return sorted(self.found) == sorted(self.truth)


def build_case_outcome(
    label: Mapping[str, Any], gap: Mapping[str, Any], figures: Mapping[str, float], seconds: float, mode: Mode
) -> CaseOutcome:
    """Return the record of a case from its label and its `gap.json`."""
    causes, rest = gap["causes"], gap["probabilities"]
    return CaseOutcome(
        **{key: label[key] for key in SAME},
        truth=tuple(effect["name"] for effect in label["effects"]),
        verdict=gap["verdict"],
        ranked=tuple(cause["effect"] for cause in causes),
        probability={**{c["effect"]: c["probability"] for c in causes}, NONE: rest["none"], UNKNOWN: rest["unknown"]},
        composition=tuple(gap["composition"]["effects"]),
        indistinguishable=tuple(frozenset(group) for group in gap["indistinguishable"]),
        figures=figures,
        seconds=seconds,
        mode=mode,
    )
