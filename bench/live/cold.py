"""Time per sample of the observer: without pause, after a millisecond of waiting, and after a millisecond of sleep.

Needs no ROS (`python bench/live/cold.py`): from current and position as numbers to the estimate's bytes, without
executor and DDS. The sample right after the first one distinguishes cold caches and branch predictors, which are warm
by then, from a processor that runs slower after a sleep, which is still slow.
"""

from __future__ import annotations

import argparse
import gc
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from builds import ROOT

sys.path.insert(0, str(ROOT))
from ces_observer.cdr.joint_state import RawEstimate
from ces_observer.current_hold import CurrentHold
from ces_observer.damper_observer import DamperObserver
from ces_observer.health.health import Health
from ces_observer.model import load_model

PERIOD_NS = 1_000_000
BATCH = 500  # samples of one kind in a row
WARM_UP = 2000


class SampleTimer:
    """One damper at 1 kHz; each call processes the next current and position and returns its time [ns]."""

    def __init__(self, path: Path) -> None:
        model = load_model(path)
        self._damper = DamperObserver(model, CurrentHold(model.sampling.max_current_age_s), 0.0)
        self._health = Health(self._damper, {})
        self._fill = RawEstimate("rear_damper").fill
        self._stamp_ns = 10**18

    def __call__(self) -> int:
        self._stamp_ns = stamp = self._stamp_ns + PERIOD_NS
        position = 0.02 * math.sin(4.0 * math.pi * 1e-9 * (stamp % 10**9))
        damper, health = self._damper, self._health
        began = time.perf_counter_ns()
        health.current.take(stamp, stamp)
        damper.take_current(stamp, 0.5)
        health.position.take(stamp, stamp)
        health.stillness.take(stamp, position)
        force = damper.step(stamp, position, stamp)
        if force is not None:
            self._fill(stamp, b"chassis", damper.position, damper.speed, force)
            health.latency.take(0)
        return time.perf_counter_ns() - began


def sleep_period() -> None:
    time.sleep(PERIOD_NS * 1e-9)


def spin_period() -> None:
    end = time.perf_counter_ns() + PERIOD_NS
    while time.perf_counter_ns() < end:
        pass


def pairs(sample: SampleTimer, wait: Callable[[], None]) -> list[tuple[int, int]]:
    """Return the times [ns] of a sample after each wait and of the one right after it."""
    times = []
    for _ in range(BATCH):
        wait()
        times.append((sample(), sample()))
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, default=ROOT / "config" / "models" / "sample.json")
    parser.add_argument("--rounds", type=int, default=10, help=f"of {BATCH} samples of each kind, default 10")
    options = parser.parse_args()
    sample = SampleTimer(options.model)
    gc.disable()  # as in the nodes
    for _ in range(WARM_UP):
        sample()
    found: dict[str, list[float]] = {}
    for _ in range(options.rounds):
        found.setdefault("in a row", []).append(median(sample() for _ in range(BATCH)))
        for name, wait in (("1 ms awake", spin_period), ("1 ms asleep", sleep_period)):
            first, second = (median(times) for times in zip(*pairs(sample, wait), strict=True))
            found.setdefault(f"after {name}", []).append(first)
            found.setdefault(f"after {name}, the second", []).append(second)
    for name, medians in found.items():
        low, middle, high = (1e-3 * ns for ns in (min(medians), median(medians), max(medians)))
        print(f"{name:32s} {middle:5.1f} us ({low:.1f} to {high:.1f})")


if __name__ == "__main__":
    main()
