"""Values beside the limits of the rules: within, outside, or undecided where the interval includes the limit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ces_identify.characteristics.rows import ControlRange, Judgement, ValveResponse
from ces_identify.characteristics.rules import CharacteristicLimits

WITHIN, OUTSIDE, UNDECIDED, UNKNOWN = "within", "outside", "undecided", "not known"
NO_INTERVAL = ", no interval"


@dataclass(frozen=True)
class JudgedColumn:
    """A column that a limit is for, that of its interval, and the factor to the unit of the limit."""

    name: str
    interval: str
    factor: float = 1.0
    at_least: bool = False


OF_STEPS: Mapping[str, JudgedColumn] = {
    "t63_ms": JudgedColumn("time_63_s", "time_63_ci95_s", 1e3),
    "t90_ms": JudgedColumn("time_90_s", "time_90_ci95_s", 1e3),
    "rise_ms": JudgedColumn("rise_s", "rise_ci95_s", 1e3),
    "settled_ms": JudgedColumn("settled_s", "settled_ci95_s", 1e3),
    "overshoot": JudgedColumn("overshoot", "overshoot_ci95"),
}
OF_RANGES: Mapping[str, JudgedColumn] = {
    "hysteresis_N": JudgedColumn("hysteresis_N", "hysteresis_ci95_N"),
    "range_N": JudgedColumn("range_N", "range_ci95_N", at_least=True),
    "ratio": JudgedColumn("ratio", "ratio_ci95", at_least=True),
}


def judge(
    limits: CharacteristicLimits, responses: Sequence[ValveResponse], ranges: Sequence[ControlRange]
) -> Iterator[Judgement]:
    """Yield a row for each value of which the rules give a limit."""
    for row in responses:
        subject = f"{row.from_A:.3g} to {row.to_A:.3g} A, {row.direction} at {abs(row.speed_m_s):.3g} m/s"
        yield from _judge_row(limits, OF_STEPS, row, subject)
    for reach in ranges:
        yield from _judge_row(limits, OF_RANGES, reach, f"{reach.direction} at {abs(reach.speed_m_s):.3g} m/s")


def _judge_row(
    limits: CharacteristicLimits, columns: Mapping[str, JudgedColumn], row: Any, subject: str
) -> Iterator[Judgement]:
    for name, column in columns.items():
        allowed = getattr(limits, name)
        if allowed is not None:
            value, reach = (column.factor * getattr(row, one) for one in (column.name, column.interval))
            room = value - allowed if column.at_least else allowed - value
            known = (WITHIN if room >= 0.0 else OUTSIDE) + NO_INTERVAL * math.isnan(reach)
            verdict = UNDECIDED if abs(room) < reach else UNKNOWN if math.isnan(value) else known
            yield Judgement(
                source=row.source, limit=name, subject=subject, value=value, value_ci95=reach, allowed=allowed,
                verdict=verdict,
            )  # fmt: skip
