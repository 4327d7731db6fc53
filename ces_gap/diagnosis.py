"""What a diagnosis is: plain records that `gap.json`, `augmented.json` and the report are written from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ces_gap.baseline.correction import LearnedCorrection
from ces_gap.baseline.surrogate import Surrogate
from ces_gap.experiment.experiment_files import NextExperiment
from ces_gap.inference.explanation import Estimate, Explanation, Interval
from ces_gap.inference.held_out import Gap, HeldOutSeries
from ces_gap.inference.verdict import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, VerdictFigures
from ces_gap.where.regions import GapMap, GapRegion, Where

__all__ = [
    "AMBIGUOUS",
    "NAMED",
    "NO_GAP",
    "UNKNOWN",
    "Diagnosis",
    "Estimate",
    "Explanation",
    "Gap",
    "GapMap",
    "GapRegion",
    "HeldOutSeries",
    "Interval",
    "NextExperiment",
    "VerdictFigures",
    "Where",
]


@dataclass(frozen=True)
class Diagnosis:
    """Everything that was found."""

    verdict: str
    sentence: str
    simulation: str  # as given on the command line
    gap: Gap
    where: Where
    causes: tuple[Explanation, ...]  # each effect alone, its best form, ranked
    composition: Explanation
    indistinguishable: tuple[tuple[str, ...], ...]
    not_separable: tuple[str, ...]  # effects that a calibration of the simulation could absorb (no references)
    invisible: tuple[tuple[str, str], ...]  # effect, and why these recordings cannot show it
    ceiling_after_N: float
    wrong: Explanation | None  # the best effect that is not in the composition: the control
    probability_none: float
    probability_unknown: float
    rest: Where | None  # where the unexplained rest lies, for "unknown"
    next_experiment: NextExperiment | None
    surrogate_cost_J: float | None  # how good the surrogate of recorded predictions is, None if the simulation was run
    held_out: tuple[HeldOutSeries, ...]
    by_region: tuple[tuple[GapRegion, float], ...] = ()  # gap after [N] in each of the regions of `where`
    notes: tuple[str, ...] = ()
    correction: LearnedCorrection | None = None  # of the baseline's own error
    surrogate: Surrogate | None = None  # of recorded predictions
    baselines: Mapping[str, str] = field(default_factory=dict)  # what simpler ways of choosing would have named
    figures: VerdictFigures | None = None  # what decided
