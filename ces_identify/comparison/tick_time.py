"""The time that the runtime's estimator takes for a tick of each model, on this machine.

Models take turns, so that a change of the machine's speed meets all of them, and only the processor's time for this
thread counts, so that other programs hardly matter. The figure is the median of the rounds; it says nothing about other
machines, but their ratio carries over.
"""

from __future__ import annotations

import gc
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ces_identify.preparation.series import usable_samples
from ces_identify.recordings.recording import Recording
from ces_observer.estimator import Estimator
from ces_observer.model import MEASURED, Model

ROUNDS = 9
TICKS = 1500  # timed in each round
WARM_UP_TICKS = 300  # before them
MAX_RESOLUTION_S = 1e-6
Sample = tuple[int, float, float, float]


@dataclass(frozen=True)
class TickTime:
    """Time for one tick [µs]: the median of the rounds, and the fastest and slowest of them."""

    median_us: float
    fastest_us: float
    slowest_us: float


def measure_tick_times(models: Sequence[Model], recording: Recording) -> list[TickTime]:
    """Return the time of a tick of each model on the motion of `recording`, at each model's own rate."""
    inputs = [_samples_at_rate(model, recording) for model in models]
    rounds = [[_time_ticks(model, one) for model, one in zip(models, inputs, strict=True)] for _ in range(ROUNDS)]
    return [TickTime(float(np.median(us)), min(us), max(us)) for us in zip(*rounds, strict=True)]


def describe_machine() -> str:
    """Return the processor and the Python that the times hold for."""
    return f"{_processor()}, Python {platform.python_version()}"


def _samples_at_rate(model: Model, recording: Recording) -> list[Sample]:
    """Return samples exactly one tick apart: stamp [ns], position [m], current [A] and motion signal."""
    samples = usable_samples(recording, 1e6)
    rate, count = model.sampling.rate_Hz, WARM_UP_TICKS + TICKS
    stamps = np.rint(np.arange(count) * (1e9 / rate)).astype(np.int64)
    seconds = (samples.stamps_ns - samples.stamps_ns[0]) * 1e-9
    at = np.mod(stamps * 1e-9, max(seconds[-1], 1.0 / rate))
    at = np.where(np.floor(stamps * 1e-9 / max(seconds[-1], 1.0 / rate)) % 2 == 1, seconds[-1] - at, at)  # to and fro
    position, current = np.interp(at, seconds, samples.position), np.interp(at, seconds, samples.current)
    motion = np.gradient(position, 1.0 / rate) if model.sampling.differentiator == MEASURED else np.zeros(count)
    return list(zip(stamps.tolist(), position.tolist(), current.tolist(), motion.tolist(), strict=True))


def _time_ticks(model: Model, samples: Sequence[Sample]) -> float:
    """Return the mean time of a tick [µs] of a new estimator, after WARM_UP_TICKS."""
    step = Estimator(model).step
    for sample in samples[:WARM_UP_TICKS]:
        step(*sample)
    timed, enabled, clock = samples[WARM_UP_TICKS:], gc.isenabled(), _choose_clock()
    gc.disable()
    try:
        began = clock()
        for sample in timed:
            step(*sample)
        return 1e6 * (clock() - began) / len(timed)
    finally:
        if enabled:
            gc.enable()


def _choose_clock() -> Callable[[], float]:
    """Return the clock of the thread's processor time [s], or of real time where that is coarse (Windows)."""
    fine = time.get_clock_info("thread_time").resolution <= MAX_RESOLUTION_S
    return time.thread_time if fine else time.perf_counter


def _processor() -> str:
    """Return the name of the processor, as far as the system gives it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
