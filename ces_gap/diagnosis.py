"""What a diagnosis is: plain records that `gap.json`, `augmented.json` and the report are written from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ces_gap.baseline.correction import LearntCorrection
from ces_gap.baseline.surrogate import Surrogate
from ces_gap.experiment.experiment_files import NextExperiment
from ces_gap.inference.explanation import Estimate, Explained, Interval
from ces_gap.inference.held_out import Gap, Series
from ces_gap.inference.verdict import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Figures
from ces_gap.where.regions import GapMap, Region, Where

__all__ = [
    "AMBIGUOUS",
    "NAMED",
    "NO_GAP",
    "UNKNOWN",
    "Diagnosis",
    "Estimate",
    "Explained",
    "Figures",
    "Gap",
    "GapMap",
    "Interval",
    "NextExperiment",
    "Region",
    "Series",
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
    causes: tuple[Explained, ...]  # each effect alone, its best form, ranked
    composition: Explained
    indistinguishable: tuple[tuple[str, ...], ...]
    not_separable: tuple[str, ...]  # effects that a calibration of the simulation could absorb (no references)
    invisible: tuple[tuple[str, str], ...]  # effect, and why these recordings cannot show it
    ceiling_after_N: float
    wrong: Explained | None  # the best effect that is not in the composition: the control
    probability_none: float
    probability_unknown: float
    rest: Where | None  # where the unexplained rest lies, for "unknown"
    next_experiment: NextExperiment | None
    surrogate_cost_J: float | None  # how good the surrogate of recorded predictions is, None if the simulation was run
    held_out: tuple[Series, ...]
    by_region: tuple[tuple[Region, float], ...] = ()  # gap after [N] in each of the regions of `where`
    notes: tuple[str, ...] = ()
    correction: LearntCorrection | None = None  # of the baseline's own error
    surrogate: Surrogate | None = None  # of recorded predictions
    baselines: Mapping[str, str] = field(default_factory=dict)  # what simpler ways of choosing would have named
    figures: Figures | None = None  # what decided
