"""The result of a diagnosis: plain records from which `gap.json`, `augmented.json` and the report are written."""

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
from ces_gap.witness.witness import Witness

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
    """The complete result of a diagnosis."""

    verdict: str
    sentence: str
    simulation: str  # as on the command line
    gap: Gap
    where: Where
    causes: tuple[Explanation, ...]  # each effect alone in its best form, ranked
    composition: Explanation
    indistinguishable: tuple[tuple[str, ...], ...]
    not_separable: tuple[str, ...]  # effects that a recalibration could absorb (without references)
    invisible: tuple[tuple[str, str], ...]  # effect, reason why these recordings cannot show it
    ceiling_after_N: float
    wrong: Explanation | None  # control: the best effect outside the composition
    no_gap_reason: str  # of the verdict "no_gap": WITHIN_... of `inference/gap_size.py`, "" otherwise
    tolerance_N: float  # a gap up to this RMS counts as none
    visible_from_N: float  # RMS below which an effect would hide behind noise and the simulation's own error
    probability_none: float
    probability_unknown: float
    rest: Where | None  # location of the unexplained rest, for "unknown"
    next_experiment: NextExperiment | None
    surrogate_cost_J: float | None  # of the surrogate of recorded predictions, None if the simulation was run
    held_out: tuple[HeldOutSeries, ...]
    by_region: tuple[tuple[GapRegion, float], ...] = ()  # gap after [N] in each region of `where`
    notes: tuple[str, ...] = ()
    correction: LearnedCorrection | None = None  # of the baseline error
    surrogate: Surrogate | None = None  # of recorded predictions
    surrogate_error: float | None = None  # its `difference_error`
    baselines: Mapping[str, str] = field(default_factory=dict)  # effects that simpler selection rules name
    figures: VerdictFigures | None = None  # the basis of the verdict
    witness: Witness | None = None  # refits of a physical model's parameters, None for other simulations
    witness_says: str = ""  # of the composition
