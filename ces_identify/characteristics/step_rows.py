"""The rows about steps of the current: every step, the mean response of each kind of step, and its course."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from ces_identify.characteristics.conditions import group_values
from ces_identify.characteristics.motion import MEASURED, RecordingMotion
from ces_identify.characteristics.rows import ResponsePoint, StepResponse, ValveResponse
from ces_identify.characteristics.steps import TRACE_S, StepTiming, find_steps, time_step
from ces_identify.numerics.arrays import F

LEVEL = 0.95
MIN_STEPS = 3  # for an interval
SINCE_STEP = ("time_63_s", "dead_time_s")
TIMES = (*SINCE_STEP, "time_constant_s", "rise_s")


@dataclass(frozen=True)
class ReadStep:
    """A row of the table of steps with the normalised force at TRACE_S; None if it could not be read."""

    row: StepResponse
    trace: F | None


def read_steps(motion: RecordingMotion, sources: Sequence[str], tolerance_A: float) -> Iterator[ReadStep]:
    """Yield every step of the current as each source responds to it."""
    for stretch in motion.stretches:
        for step in find_steps(stretch, tolerance_A):
            at: dict[str, Any] = {"recording": motion.name, "time_s": step.time_s, "time_doubt_s": step.doubt_s}
            at |= {"from_A": step.from_A, "to_A": step.to_A}
            for source in sources:
                timing = time_step(stretch, step, stretch.forces[source], motion.force_noise_N)
                if isinstance(timing, StepTiming):
                    values = {name: value for name, value in vars(timing).items() if name != "trace"}
                    yield ReadStep(StepResponse(source=source, **at, **values), timing.trace)
                else:
                    yield ReadStep(StepResponse(source=source, **at, note=timing), None)


def group_steps(steps: Sequence[ReadStep], tolerance_A: float) -> list[list[ReadStep]]:
    """Return the steps that were read in groups of one change, direction and source, in this order."""
    read = [step for step in steps if step.trace is not None]
    levels = [_number_levels([getattr(s.row, name) for s in read], tolerance_A) for name in ("from_A", "to_A")]
    groups: dict[tuple[int, int, str, bool, str], list[ReadStep]] = {}
    for step, a, b in zip(read, *levels, strict=True):
        row = step.row
        groups.setdefault((a, b, row.direction, row.source != MEASURED, row.source), []).append(step)
    return [group for _, group in sorted(groups.items(), key=lambda item: item[0])]


def response_row(group: Sequence[ReadStep]) -> ValveResponse:
    """Return the mean response of a group."""

    def average(name: str) -> float:
        return float(np.mean([getattr(step.row, name) for step in group]))

    doubt = average("time_doubt_s")
    times = {name: average(name) for name in TIMES}
    widths = {f"{n[:-2]}_ci95_s": _half_interval(group, n, doubt if n in SINCE_STEP else 0.0) for n in TIMES}
    return ValveResponse(
        source=group[0].row.source,
        from_A=average("from_A"),
        to_A=average("to_A"),
        change="up" if average("to_A") > average("from_A") else "down",
        direction=group[0].row.direction,
        steps=len(group),
        speed_m_s=average("speed_m_s"),
        force_change_N=average("after_N") - average("before_N"),
        **times,
        **widths,
        note="" if len(group) >= MIN_STEPS else f"fewer than {MIN_STEPS} steps: no interval",
    )


def response_points(group: Sequence[ReadStep]) -> Iterator[ResponsePoint]:
    """Yield the mean course of a group, as long as all its steps last."""
    response = response_row(group)
    traces = np.stack([step.trace for step in group if step.trace is not None])
    for k, time in enumerate(TRACE_S):
        shares = traces[:, k]
        if np.isfinite(shares).all():
            yield ResponsePoint(
                source=response.source,
                from_A=response.from_A,
                to_A=response.to_A,
                direction=response.direction,
                time_s=float(time),
                steps=len(shares),
                share=float(shares.mean()),
                share_sd=float(shares.std(ddof=1)) if len(shares) >= MIN_STEPS else np.nan,
            )


def _half_interval(group: Sequence[ReadStep], name: str, doubt_s: float) -> float:
    """Return half the 95 % interval of the mean [s], widened by a doubt that steps may share; NaN for few steps."""
    if len(group) < MIN_STEPS:
        return np.nan
    values = np.array([getattr(step.row, name) for step in group])
    reach = student.ppf(0.5 + LEVEL / 2, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return float(reach + doubt_s)


def _number_levels(currents: Sequence[float], tolerance_A: float) -> list[int]:
    """Return the number of the level of each current."""
    levels = np.zeros(len(currents), np.int64)
    for number, members in enumerate(group_values(np.array(currents), tolerance_A)):
        levels[members] = number
    return [int(level) for level in levels]
