"""The size of the gap: whether it is one at all, and whether it stands clear of noise and of the simulation's error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_gap.inference.evidence import Evidence
from ces_gap.inference.learn_baseline import Baseline
from ces_gap.inference.search import EffectSearchResult
from ces_gap.trace import F

TOLERANCE_SHARE = 0.01  # of the RMS force: a smaller gap is none, unless the user asks for another tolerance
TOLERANCE_NOISES = 2.0  # times the noise: limit of that default, so that a gap clear of the noise is not overlooked
WITHIN_TOLERANCE, WITHIN_NOISE, WITHIN_TIMING, WITHIN_BASELINE = "tolerance", "noise", "timing", "baseline_error"
CLEAR = 1.5  # times noise and tolerance: a smaller gap is not named without references


@dataclass(frozen=True)
class GapSize:
    """The gap on the fitted recordings, RMS [N]: without noise, and after the simulation's timing was fitted as well.

    `noise_N` was measured, `force_N` is the RMS of the measured force; `corrected` if references taught a correction.
    """

    gap_N: float
    timed_N: float
    noise_N: float
    force_N: float
    corrected: bool


def measure_gap(baseline: Baseline, result: EffectSearchResult, rest_N: float) -> GapSize:
    """Return the size of the gap on the fitted recordings; noise that was not measured is at most the `rest_N` [N]."""
    evidence = result.evidence
    force = np.concatenate([t.force[t.usable] for t in evidence.traces])
    noise_N = float(np.sqrt(np.mean([t.noise_N**2 for t in evidence.traces])))
    if not all(t.measured_noise.known for t in evidence.traces):
        noise_N = max(noise_N, rest_N)
    timing = next((f for f in result.alone if f.effects[0].nuisance), None)
    gaps = [_rms_gap(evidence, evidence.alone)]
    gaps += [] if timing is None else [_rms_gap(evidence, evidence.forces(timing.composition))]
    above = [float(np.sqrt(max(gap**2 - noise_N**2, 0.0))) for gap in gaps]
    return GapSize(above[0], min(above), noise_N, float(np.sqrt(np.mean(force**2))), baseline.correction is not None)


def _rms_gap(evidence: Evidence, forces: Sequence[F]) -> float:
    errors = [(t.force - f)[t.usable] for t, f in zip(evidence.traces, forces, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def tolerance_N(size: GapSize, share: float | None) -> float:
    """Return the gap [N] that counts as none: a `share` of the RMS force, by default small beside force and noise."""
    if share is not None:
        return share * size.force_N
    return min(TOLERANCE_SHARE * size.force_N, TOLERANCE_NOISES * size.noise_N)


def find_no_gap_reason(size: GapSize, improbable: bool, limit_N: float) -> str:
    """Return why there is no gap, "" if there is one; `improbable` if the figures speak against one.

    Without references a gap larger than the noise is never called none, whatever the figures say.
    """
    if size.gap_N <= limit_N:
        return WITHIN_TOLERANCE
    if improbable and size.corrected:
        return WITHIN_BASELINE
    if improbable and size.timed_N <= size.noise_N:
        return WITHIN_NOISE if size.gap_N <= size.noise_N else WITHIN_TIMING
    return ""


def is_clear_of_the_simulation(size: GapSize, limit_N: float) -> bool:
    """True if a gap may be named: without references, a small one may be the simulation's own error."""
    return size.corrected or size.gap_N > CLEAR * max(size.noise_N, limit_N)
