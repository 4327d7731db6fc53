"""Samples through the estimator, in the subset of the tick: CPython and Numba run this loop; C is printed from it."""

from math import nan

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.bank import DELAY
from ces_observer.tick.estimator import (
    FORCE,
    LATE_COUNT,
    LATE_STAMPS,
    LATE_VALUES,
    LATE_WIDTH,
    estimator_reset,
    estimator_step,
)
from ces_observer.tick.model import CLAMPED
from ces_observer.tick.run import run_half_width
from ces_observer.tick.tracker import TRACK_POSITION, TRACK_SPEED

ROW = 5  # force, position, speed, half-width, clamped


def run_samples(
    p: Floats, n: Ints, s: Floats, k: Ints,
    model_p: Floats, model_n: Ints, model_s: Floats, model_k: Ints,
    count: int, stamps: Ints, inputs: Floats, rows: Floats, reasons: Ints, later_stamps: Ints, later: Floats,
) -> int:  # fmt: skip
    """Run samples (stamp; position, current and motion); return how many late estimates there are."""
    estimator_reset(p, n, s, k, model_p, model_n, model_s, model_k)
    known = 0
    for i in range(count):
        reasons[i] = estimator_step(
            p, n, s, k, model_p, model_n, model_s, model_k,
            stamps[i], inputs[3 * i], inputs[3 * i + 1], inputs[3 * i + 2],
        )  # fmt: skip
        rows[ROW * i] = s[FORCE]
        rows[ROW * i + 1] = s[TRACK_POSITION]
        rows[ROW * i + 2] = s[TRACK_SPEED]
        rows[ROW * i + 3] = nan if n[DELAY] > 0 else run_half_width(model_p, model_n, model_s)
        rows[ROW * i + 4] = float(model_k[CLAMPED])
        for j in range(k[LATE_COUNT] if known + k[LATE_COUNT] <= count else 0):
            later_stamps[known] = k[n[LATE_STAMPS] + j]
            for m in range(LATE_WIDTH):
                later[LATE_WIDTH * known + m] = s[n[LATE_VALUES] + LATE_WIDTH * j + m]
            known += 1
    return known
