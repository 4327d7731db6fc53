"""The rows of the tables about cycles, for each condition and source."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ces_identify.characteristics.conditions import Condition
from ces_identify.characteristics.cycle_values import COMPRESSION, DIRECTIONS, REBOUND, SHARES, CycleValues
from ces_identify.characteristics.cycles import HALF, Cycles
from ces_identify.characteristics.knee import KneeFit, find_knee
from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.rows import ContinuousForce, CycleWork, Knee, LoopPoint, PeakForce
from ces_identify.numerics.arrays import F

MIN_CYCLES = 3  # for a spread, a loop, work, branches and a knee
FEW = f"fewer than {MIN_CYCLES} cycles: no spread"


@dataclass(frozen=True)
class SourceValues:
    """The values of the cycles of one condition by one source, beside the measured ones."""

    source: str
    condition: Condition
    cycles: Cycles
    values: CycleValues
    measured: CycleValues

    @property
    def key(self) -> dict[str, Any]:
        """The columns that all tables about cycles share."""
        c = self.condition
        count = int(np.isfinite(self.values.work_J).sum())
        means = {name: getattr(c, name) for name in ("current_A", "current_width_A", "amplitude_m", "frequency_Hz")}
        return {"source": self.source, "cycles": count, **means}

    def difference(self, values: F, measured: F) -> F:
        """Return values minus measured ones; NaN for the measurement itself."""
        return values - measured if self.source != MEASURED else np.full_like(values, np.nan)


def peak_rows(one: SourceValues) -> Iterator[PeakForce]:
    """Yield the peak velocity pick-up in both directions."""
    for direction in DIRECTIONS:
        half, measured = one.values.halves[direction], one.measured.halves[direction]
        difference = one.difference(half.peak_force, measured.peak_force)
        yield PeakForce(
            **one.key,
            direction=direction,
            speed_m_s=mean(half.peak_speed),
            force_N=mean(half.peak_force),
            force_sd_N=spread(half.peak_force),
            difference_N=mean(difference),
            difference_sd_N=spread(difference),
            note=FEW if one.key["cycles"] < MIN_CYCLES else "",
        )


def continuous_rows(one: SourceValues) -> Iterator[ContinuousForce]:
    """Yield force and hysteresis at shares of the peak speed in both directions."""
    for direction in DIRECTIONS:
        half, measured = one.values.halves[direction], one.measured.halves[direction]
        difference, width = one.difference(half.mean, measured.mean), half.width
        speed = mean(half.peak_speed)
        for k, share in enumerate(SHARES):
            yield ContinuousForce(
                **one.key,
                direction=direction,
                speed_m_s=float(share) * speed,
                accelerating_N=mean(half.accelerating[:, k]),
                decelerating_N=mean(half.decelerating[:, k]),
                force_N=mean(half.mean[:, k]),
                force_sd_N=spread(half.mean[:, k]),
                width_N=mean(width[:, k]),
                width_sd_N=spread(width[:, k]),
                difference_N=mean(difference[:, k]),
            )


def loop_rows(one: SourceValues) -> Iterator[LoopPoint]:
    """Yield the mean loop, from full rebound over full compression back."""
    cycles, force = one.cycles, one.cycles.forces[one.source]
    for k in range(2 * HALF + 1):
        yield LoopPoint(
            **one.key,
            phase=k / (2 * HALF),
            position_m=mean(cycles.position[:, k]),
            speed_m_s=mean(cycles.speed[:, k]),
            force_N=mean(force[:, k]),
            force_sd_N=spread(force[:, k]),
        )


def work_row(one: SourceValues) -> CycleWork:
    """Return work, equivalent damping and the forces at zero speed."""
    values = one.values
    difference = one.difference(values.work_J, one.measured.work_J)
    middle, width = 0.5 * (values.top_N + values.bottom_N), values.top_N - values.bottom_N
    compression, rebound = (mean(values.halves[d].peak_force) for d in (COMPRESSION, REBOUND))
    dissipates = mean(values.work_J) > 0.0
    damped = dissipates and compression > 0.0 > rebound
    return CycleWork(
        **one.key,
        work_J=mean(values.work_J),
        work_sd_J=spread(values.work_J),
        power_W=mean(values.power_W),
        damping_Ns_m=mean(values.damping_Ns_m) if dissipates else np.nan,
        damping_sd_Ns_m=spread(values.damping_Ns_m) if dissipates else np.nan,
        mid_force_N=mean(middle),
        mid_force_sd_N=spread(middle),
        zero_width_N=mean(width),
        zero_width_sd_N=spread(width),
        zero_width_per_ms_N=mean(values.width_per_skew_N),
        rebound_ratio=-rebound / compression if damped else np.nan,
        difference_J=mean(difference),
        difference_sd_J=spread(difference),
        note=_describe_work(dissipates, damped),
    )


def knee_rows(one: SourceValues) -> Iterator[Knee]:
    """Yield the knee in both directions, or why there is none."""
    for direction in DIRECTIONS:
        knee = find_knee(one.values.halves[direction])
        key = {**one.key, "direction": direction}
        if isinstance(knee, KneeFit):
            yield Knee(
                **key,
                knee_speed_m_s=knee.speed_m_s,
                knee_speed_sd_m_s=knee.speed_sd_m_s,
                knee_force_N=knee.force_N,
                slope_below_Ns_m=knee.slope_below_Ns_m,
                slope_above_Ns_m=knee.slope_above_Ns_m,
            )
        else:
            yield Knee(**key, note=knee)


def mean(values: F) -> float:
    """Return the mean of the finite values, NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


def spread(values: F) -> float:
    """Return the standard deviation of the finite values, NaN for fewer than MIN_CYCLES."""
    known = values[np.isfinite(values)]
    return float(known.std(ddof=1)) if len(known) >= MIN_CYCLES else np.nan


def _describe_work(dissipates: bool, damped: bool) -> str:
    if not dissipates:
        return "the loop dissipates nothing: check the sign of force or position, or the delay between them"
    return "" if damped else "one direction does not resist: no ratio (offset of the force?)"
