"""Values beside the limits of the rules: within, outside, or undecided where the interval includes the limit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ces_identify.characteristics.motion import MEASURED
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
    """Yield a row for each value of which the rules give a limit, or one that says that there is no value."""
    steps = [(row, f"{row.from_A:.3g} to {row.to_A:.3g} A, {row.direction}") for row in responses]
    reaches = [(reach, reach.direction) for reach in ranges]
    for rows, columns, nothing in ((steps, OF_STEPS, "no step was read"), (reaches, OF_RANGES, "no two currents")):
        for name, column in columns.items():
            allowed = getattr(limits, name)
            if allowed is not None and not rows:
                yield Judgement(source=MEASURED, limit=name, subject=nothing, allowed=allowed, verdict=UNKNOWN)
            elif allowed is not None:
                for row, subject in rows:
                    yield _judge_row(row, f"{subject} at {abs(row.speed_m_s):.3g} m/s", name, column, allowed)


def _judge_row(row: Any, subject: str, name: str, column: JudgedColumn, allowed: float) -> Judgement:
    value, reach = (column.factor * getattr(row, one) for one in (column.name, column.interval))
    room = value - allowed if column.at_least else allowed - abs(value)
    known = (WITHIN if room >= 0.0 else OUTSIDE) + NO_INTERVAL * math.isnan(reach)
    return Judgement(
        source=row.source,
        limit=name,
        subject=subject,
        value=value,
        value_ci95=reach,
        allowed=allowed,
        verdict=UNDECIDED if abs(room) < reach else UNKNOWN if math.isnan(value) else known,
    )
