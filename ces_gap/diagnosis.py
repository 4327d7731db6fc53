"""The result of a diagnosis: the record from which files and reports are written."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ces_data.reading import import_pandas
from ces_gap.baseline.learner import LearnedCorrection
from ces_gap.baseline.twin import Twin
from ces_gap.effects.effect import Composition
from ces_gap.experiment.next_experiment import NextExperiment
from ces_gap.grid import is_constant
from ces_gap.inference.explanation import Explanation
from ces_gap.inference.fit import Estimate, Interval
from ces_gap.inference.held_out import Gap, HeldOutSeries
from ces_gap.inference.judgement import (
    AMBIGUOUS,
    CALIBRATION,
    NAMED,
    NO_GAP,
    PARAMETERS,
    UNKNOWN,
    VerdictFigures,
)
from ces_gap.inference.rare import RareDeviation
from ces_gap.inputs.probe_result import NOT_PROBED, SimulationProbe
from ces_gap.regions.axes import GapMap, GapRegion, Where
from ces_gap.trace import usable_inputs, usable_values
from ces_report.table import PrintedResult, PrintedResults

__all__ = [
    "AMBIGUOUS", "NAMED", "NO_GAP", "UNKNOWN", "Diagnosis", "Estimate", "Explanation", "Explanations", "Gap", "GapMap",
    "GapRegion", "HeldOutSeries", "Interval", "NextExperiment", "VerdictFigures", "Where",
]  # fmt: skip


class Explanations(PrintedResults[Explanation]):
    """Explanations that print themselves as a table."""


@dataclass(frozen=True)
class Possibility:
    """What may be behind a gap, with its probability: an explanation, or what is none."""

    effects: tuple[str, ...]
    probability: float
    explanation: Explanation | None = None


OUTSIDE, NOTHING = "none of these", "no effect"  # of an unknown cause, and of noise alone


@dataclass(frozen=True, repr=False)
class Diagnosis(PrintedResult):
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
    no_gap_reason: str  # of the verdict "no_gap": `Within`, "" otherwise
    tolerance_N: float  # a gap up to this RMS counts as none
    visible_from_N: float  # RMS below which an effect would hide behind noise and the simulation's own error
    probability_none: float
    probability_unknown: float
    rest: Where | None  # location of the unexplained rest, for "unknown"
    next_experiment: NextExperiment | None
    is_recorded: bool  # whether the simulation is known from recorded predictions only
    held_out: tuple[HeldOutSeries, ...]
    by_region: tuple[tuple[GapRegion, float], ...] = ()  # gap after [N] in each region of `where`
    notes: tuple[str, ...] = ()
    seen_notes: tuple[str, ...] = ()  # those on recordings from which the simulation was identified
    correction: LearnedCorrection | None = None  # of the baseline error
    twin: Twin | None = None  # of the simulation
    figures: VerdictFigures | None = None  # the basis of the verdict
    doubt: str = ""  # what keeps a cause from being named: `Doubt`
    alternatives: tuple[str, ...] = ()  # effects outside the composition that stay possible
    explained_as_well: tuple[tuple[str, ...], ...] = ()  # by each of these, parameters and effects together
    timed_N: float = float("nan")  # gap after the simulation's timing was fitted
    probe: SimulationProbe = NOT_PROBED  # what the simulation does to its inputs
    rare: RareDeviation | None = None  # the largest local deviation, if it stands out

    def __post_init__(self) -> None:
        """Let the causes print themselves."""
        object.__setattr__(self, "causes", Explanations(self.causes))

    @property
    def is_combined(self) -> bool:
        """Whether several effects act together."""
        return len(self.composition.effects) > 1

    @property
    def is_recalibrated(self) -> bool:
        """Whether parameters of the simulation were changed first, which are a cause of the whole gap."""
        return PARAMETERS in self.composition.effects and self.correction is None

    @property
    def base_N(self) -> float:
        """The gap [N] of which every shrink is a share: that which the correction leaves, if any."""
        return self.gap.rms_N if self.is_recalibrated else self.gap.corrected_N

    @property
    def possibilities(self) -> tuple[Possibility, ...]:
        """What may be behind the gap: effects together, each alone, ranked, and what is no effect of the library.

        The probability of each is that it is a cause. An effect of several together has that of all, which counts once
        in the sum of 1.
        """
        explained = (*([self.composition] if self.is_combined else []), *self.causes)
        rest = (OUTSIDE, self.probability_unknown), (NOTHING, self.probability_none)
        return (
            *(Possibility(one.effects, one.probability, one) for one in explained),
            *(Possibility((name,), probability) for name, probability in rest),
        )

    def to_frame(self) -> Any:
        """Return the possibilities as a DataFrame: effects and forms, numbers with their units in the labels."""
        nothing = Explanation((), (), Composition(), (), math.nan, math.nan, (math.nan, math.nan))
        rows = []
        for one in self.possibilities:
            found = one.explanation or nothing
            rows.append(
                {
                    "effect": " + ".join(one.effects),
                    "form": " + ".join(found.forms),
                    "probability_percent": 100.0 * one.probability,
                    "gap_left_N": found.gap_after_N,
                    "shrink_percent": 100.0 * found.shrink,
                    "shrink_low_percent": 100.0 * found.shrink_ci95[0],
                    "shrink_high_percent": 100.0 * found.shrink_ci95[1],
                }
            )
        return import_pandas().DataFrame(rows)


SPEED_SHARES = np.array([0.0, 0.05, 0.35, 0.65, 0.95, 1.0])  # quantiles that bound the cells of speed
CURRENT_SHARES = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
MIN_TICKS = 10


@dataclass(frozen=True)
class CalibrationCell:
    """The mean force [N] that the map adds within ranges of speed [m/s] and current [A]."""

    speed_m_s: tuple[float, float]
    current_A: tuple[float, float]
    force_N: float


def calibration_cells(diagnosis: Diagnosis) -> tuple[CalibrationCell, ...]:
    """Return the cells of the composition's calibration on the held-out recordings; none if it has none."""
    setting = next((s for s in diagnosis.composition.composition.settings if s.name == CALIBRATION), None)
    traces = [s.trace for s in diagnosis.held_out]
    if setting is None or not traces:
        return ()
    maps = [setting.effect.respond(t, t.inputs, np.zeros(len(t)), setting.values) for t in traces]
    if setting.effect.edits and diagnosis.twin is not None:
        maps = [diagnosis.twin.change(t, t.inputs, Composition((setting,))) for t in traces]
    added, speed, current = (usable_values(traces, maps), *(usable_inputs(traces, n) for n in ("speed", "current")))
    speeds = np.quantile(speed, SPEED_SHARES)
    ends = np.array([current.min(), current.max()])
    currents = ends if is_constant(current) else np.quantile(current, CURRENT_SHARES)
    rows = [(low, high, (speed >= low) & (speed <= high)) for low, high in pairwise(speeds)]
    columns = [(low, high, (current >= low) & (current <= high)) for low, high in pairwise(currents)]
    return tuple(
        CalibrationCell((float(a), float(b)), (float(c), float(d)), float(added[row & column].mean()))
        for a, b, row in rows
        for c, d, column in columns
        if (row & column).sum() >= MIN_TICKS
    )


def find_closest(diagnosis: Diagnosis) -> Explanation | None:
    """Return what leaves least of the held-out gap, the composition or an effect alone; None if nothing shrinks it."""
    together = [diagnosis.composition] if diagnosis.composition.effects else []
    explanations = [e for e in (*together, *diagnosis.causes) if e.gap_after_N < diagnosis.gap.corrected_N]
    return min(explanations, key=lambda e: e.gap_after_N, default=None)


def find_best_other(diagnosis: Diagnosis, shown: Explanation) -> Explanation | None:
    """Return the effect that alone closes most beside what is `shown`; None if there is none."""
    others = [c for c in diagnosis.causes if c.effects[0] not in shown.effects and math.isfinite(c.shrink)]
    return max(others, key=lambda c: c.shrink, default=None)
