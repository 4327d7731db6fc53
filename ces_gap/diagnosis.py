"""What a diagnosis is: plain records that `gap.json`, `augmented.json` and the report are written from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.correction import LearntCorrection
from ces_gap.baseline.surrogate import Surrogate
from ces_gap.effects.effect import Composition
from ces_gap.inference.verdict import Figures
from ces_gap.trace import Trace

F = NDArray[np.float64]
B = NDArray[np.bool_]
Interval = tuple[float, float]

NAMED, AMBIGUOUS, UNKNOWN, NO_GAP = "named", "ambiguous", "unknown", "no_gap"


@dataclass(frozen=True)
class Gap:
    """The gap on the held-out recordings, RMS [N] with measurement noise taken out.

    `rms_N` of the simulation as given; `corrected_N` once the baseline's own error, learnt from references, is added
    (equal to `rms_N` without references). `noise_floor_N` is what no model can explain. `cost_J` is thesis eq. 3.5.
    """

    rms_N: float
    ci95_N: Interval
    noise_floor_N: float
    cost_J: float
    corrected_N: float
    corrected_ci95_N: Interval


@dataclass(frozen=True)
class Region:
    """One region of one axis; `low` and `high` in the axis' unit. `share_of_energy` of the noise-corrected gap.

    `q_value` is the false-discovery rate at which the region's mean energy exceeds the rest of its axis.
    """

    axis: str
    low: float
    high: float
    share_of_energy: float
    share_of_samples: float
    rms_N: float
    ci95_N: Interval
    q_value: float


@dataclass(frozen=True)
class GapMap:
    """The gap over two axes: `rms_N` (b, a), NaN where fewer than enough samples lie; edges (a+1,), (b+1,)."""

    axes: tuple[str, str]
    edges: tuple[F, F]
    rms_N: F
    samples: F


@dataclass(frozen=True)
class Where:
    """Regions of all axes, most energy first; the largest standardised excess over regions and its p-value; maps."""

    regions: tuple[Region, ...]
    strongest: Region | None
    max_p_value: float
    maps: tuple[GapMap, ...]


@dataclass(frozen=True)
class Estimate:
    """A parameter's value with its 95 % interval, SI; `at_bound` if it stuck there, `drifts` if folds disagree."""

    name: str
    value: float
    ci95: Interval
    at_bound: bool = False
    drifts: bool = False


@dataclass(frozen=True)
class Explained:
    """What an effect, or several together, explain. Shrink and gap are on held-out recordings, noise taken out."""

    effects: tuple[str, ...]
    forms: tuple[str, ...]
    composition: Composition
    estimates: tuple[tuple[Estimate, ...], ...]  # by effect
    gap_after_N: float
    shrink: float
    shrink_ci95: Interval
    gain: float = 0.0  # cross-fitted share of the gap's energy explained on the recordings the fit saw in part
    gain_error: float = 0.0
    probability: float = 0.0
    by_region: tuple[tuple[Region, float], ...] = ()  # gap after [N] in each of the regions that matter


@dataclass(frozen=True)
class Series:
    """One held-out recording for the plots: forces [N] (n,) of simulation as given, corrected, and with the effects."""

    trace: Trace
    corrected: F
    augmented: F


@dataclass(frozen=True)
class NextExperiment:
    """The experiment that would tell more: `recipe` for `ces rig`; `time_s`, `position_m`, `current_A` (n,) its CSV.

    `separates` are the effects it tells apart and `distance_N` by how much; empty where no twin asked for it.
    """

    name: str
    purpose: str
    recipe: dict[str, Any]
    time_s: F
    position_m: F
    current_A: F
    separates: tuple[str, ...] = ()
    distance_N: float = 0.0


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
    notes: tuple[str, ...] = field(default=())
    correction: LearntCorrection | None = None  # of the baseline's own error
    surrogate: Surrogate | None = None  # of recorded predictions
    baselines: dict[str, str] = field(default_factory=dict)  # what simpler ways of choosing would have named
    figures: Figures | None = None  # what decided
