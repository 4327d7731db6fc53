"""The rows about steps of the current: every step, and the mean response of each kind of step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.stats import t as student

from ces_identify.characteristics.conditions import group_values
from ces_identify.characteristics.motion import MEASURED, RecordingMotion
from ces_identify.characteristics.rows import StepResponse, ValveResponse
from ces_identify.characteristics.steps import StepTiming, find_steps, time_step

LEVEL = 0.95
MIN_STEPS = 3  # for an interval
TIMES = ("time_63_s", "dead_time_s", "time_constant_s", "rise_s")


def step_rows(motion: RecordingMotion, sources: Sequence[str], tolerance_A: float) -> Iterator[StepResponse]:
    """Yield the response to every step of the current, by every source."""
    for stretch in motion.stretches:
        for step in find_steps(stretch, tolerance_A):
            for source in sources:
                timing = time_step(stretch, step, stretch.forces[source], motion.force_noise_N)
                key = {
                    "source": source,
                    "recording": motion.name,
                    "time_s": step.time_s,
                    "time_doubt_s": step.doubt_s,
                    "from_A": step.from_A,
                    "to_A": step.to_A,
                }
                yield StepResponse(**key, **(vars(timing) if isinstance(timing, StepTiming) else {"note": timing}))


def response_rows(steps: Sequence[StepResponse], tolerance_A: float) -> Iterator[ValveResponse]:
    """Yield the mean response to steps between the same levels, in the same direction of motion, by source."""
    read = [step for step in steps if not step.note]
    from_level, to_level = (_level_of(np.array([getattr(s, name) for s in read]), tolerance_A) for name in ("from_A", "to_A"))
    groups: dict[tuple[str, int, int, str], list[StepResponse]] = {}
    for step, a, b in zip(read, from_level, to_level, strict=True):
        groups.setdefault((step.source, a, b, step.direction), []).append(step)
    order = sorted(groups.items(), key=lambda item: (item[0][1], item[0][2], item[0][3], item[0][0] != MEASURED, item[0][0]))
    for (source, _, _, direction), members in order:
        yield _summarise(source, direction, members)


def _summarise(source: str, direction: str, steps: Sequence[StepResponse]) -> ValveResponse:
    def average(name: str) -> float:
        return float(np.mean([getattr(step, name) for step in steps]))

    doubt = average("time_doubt_s")
    times = {name: average(name) for name in TIMES}
    widths = {f"{n[:-2]}_ci95_s": _half_interval(steps, n, doubt if n in TIMES[:2] else 0.0) for n in TIMES}
    return ValveResponse(
        source=source,
        from_A=average("from_A"),
        to_A=average("to_A"),
        change="up" if average("to_A") > average("from_A") else "down",
        direction=direction,
        steps=len(steps),
        speed_m_s=average("speed_m_s"),
        force_change_N=average("after_N") - average("before_N"),
        **times,
        **widths,
        note="" if len(steps) >= MIN_STEPS else f"fewer than {MIN_STEPS} steps: no interval",
    )


def _half_interval(steps: Sequence[StepResponse], name: str, doubt_s: float) -> float:
    """Return half the 95 % interval of the mean [s], widened by a doubt that steps may share; NaN for few steps."""
    if len(steps) < MIN_STEPS:
        return np.nan
    values = np.array([getattr(step, name) for step in steps])
    reach = student.ppf(0.5 + LEVEL / 2, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return float(np.hypot(reach, doubt_s))


def _level_of(values: np.ndarray[tuple[int], np.dtype[np.float64]], tolerance_A: float) -> list[int]:
    """Return the number of the level of each current (n,)."""
    levels = np.zeros(len(values), np.int64)
    for number, members in enumerate(group_values(values, tolerance_A)):
        levels[members] = number
    return [int(level) for level in levels]
