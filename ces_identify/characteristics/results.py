"""The result: all tables, and what is known of the recordings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ces_identify.characteristics.rows import (
    ContinuousForce,
    CycleWork,
    Knee,
    LoopPoint,
    Omission,
    PeakForce,
    ResponsePoint,
    SpeedBin,
    StepResponse,
    ValveResponse,
)


@dataclass(frozen=True)
class RecordingFacts:
    """A recording: its length, bandwidth and noise of the speed, noise of the force, cycles found and used."""

    name: str
    duration_s: float
    rate_Hz: float
    bandwidth_Hz: float
    speed_noise_m_s: float
    force_noise_N: float
    cycles: int
    cycles_used: int


@dataclass(frozen=True)
class Characteristics:
    """The tables; `sources` are "measured" and the simulations, in the order of the rows."""

    sources: tuple[str, ...]
    current_tolerance_A: float
    recordings: tuple[RecordingFacts, ...]
    peak_velocity: tuple[PeakForce, ...]
    continuous: tuple[ContinuousForce, ...]
    loops: tuple[LoopPoint, ...]
    work: tuple[CycleWork, ...]
    knees: tuple[Knee, ...]
    responses: tuple[ValveResponse, ...]
    response_points: tuple[ResponsePoint, ...]
    steps: tuple[StepResponse, ...]
    speed_bins: tuple[SpeedBin, ...]
    omissions: tuple[Omission, ...]


TABLES: dict[str, type[Any]] = {
    "peak_velocity": PeakForce,
    "continuous": ContinuousForce,
    "loops": LoopPoint,
    "work": CycleWork,
    "knees": Knee,
    "responses": ValveResponse,
    "response_points": ResponsePoint,
    "steps": StepResponse,
    "speed_bins": SpeedBin,
    "omissions": Omission,
}
