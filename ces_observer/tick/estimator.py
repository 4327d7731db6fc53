"""The estimator: stamped position and current in; the damping force at that sample out, or why there is none.

A model with a delay estimates the force of a sample when its speed is known better, so many ticks later. Each tick
waits in a ring with the stamp, the current and the place of the sample that began it. p, n, s and k are those of
tracker and estimator.
"""

from math import isfinite, nan

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.bank import BANK_POSITION, BANK_SPEED, DELAY, TICK_S
from ces_observer.tick.model import WAIT, are_indices, lies_within
from ces_observer.tick.run import check_run, run_advance, run_force, run_half_width, run_restart
from ces_observer.tick.tracker import (
    AHEAD, K_ESTIMATOR, LATE_AT, LATE_KNOWN, LATE_TICKS, N_ESTIMATOR, NOT_FINITE, OK, OLD_POSITION, OLD_SPEED,
    OUT_OF_ORDER, RESTARTED, S_ESTIMATOR, TICKS, UNBOUNDED, UNSETTLED, WARMING_UP, check_tracker, tracker_advance,
    tracker_reset,
)  # fmt: skip

# n: where the ring begins in s and k, and where the late estimates do
RING_VALUES, RING_STAMPS, LATE_VALUES, LATE_STAMPS, N_ESTIMATOR_END = range(N_ESTIMATOR, N_ESTIMATOR + 5)

# s: the force [N] at the last sample, no number if it is withheld or comes later
FORCE, S_ESTIMATOR_END = range(S_ESTIMATOR, S_ESTIMATOR + 2)

# k: the last reason, what a warm-up is for, the reason of the last late estimate, the next place in the ring, how many
# ticks it holds, and how many late estimates the last sample has brought
(
    REASON, CAUSE, LATE_REASON, RING_NEXT, RING_COUNT, LATE_COUNT, K_ESTIMATOR_END,
) = range(K_ESTIMATOR, K_ESTIMATOR + 7)  # fmt: skip

MAX_STAMP = 4611686018427387903  # [ns] 2^62 - 1: the difference of two stamps is a number of 64 bits
MAX_COUNT = 1099511627776  # 2^40, of a whole number of a model: 10 s in ns are less
# of a tick in the ring: its current [A] and its sample's place [ticks]; its stamp [ns], and whether it has one
RING_WIDTH = 2
LATE_WIDTH = 4  # of a late estimate: position [m], speed [m/s], force [N], half-width [N] of its band


def estimator_reset(
    p: Floats, n: Ints, s: Floats, k: Ints, model_p: Floats, model_n: Ints, model_s: Floats, model_k: Ints
) -> None:  # fmt: skip
    """Bring the estimator back to new."""
    tracker_reset(p, n, s, k)
    _restart_model(k, model_p, model_n, model_s, model_k)
    s[FORCE] = nan
    k[LATE_COUNT] = 0
    k[REASON] = WARMING_UP
    k[CAUSE] = OK


def _restart_model(k: Ints, model_p: Floats, model_n: Ints, model_s: Floats, model_k: Ints) -> None:
    k[RING_NEXT] = 0
    k[RING_COUNT] = 0
    k[LATE_REASON] = WARMING_UP
    run_restart(model_p, model_n, model_s, model_k)


def estimator_step(
    p: Floats, n: Ints, s: Floats, k: Ints, model_p: Floats, model_n: Ints, model_s: Floats, model_k: Ints,
    stamp: int, position: float, current: float, motion: float,
) -> int:  # fmt: skip
    """Take a sample [ns, m, A]; return the reason, OK with the force in FORCE and the late estimates in LATE_VALUES.

    `motion` is the measured speed [m/s] or acceleration [m/s2] if the sampling names one. Bad samples count as missing.
    """
    k[LATE_COUNT] = 0
    s[FORCE] = nan
    outcome = NOT_FINITE
    if isfinite(current):
        outcome = OUT_OF_ORDER
        if -MAX_STAMP <= stamp <= MAX_STAMP:
            outcome = tracker_advance(p, n, s, k, stamp, position, motion)
    if outcome != OK:
        if outcome != RESTARTED and outcome != UNSETTLED:
            k[REASON] = outcome
            return outcome
        k[CAUSE] = outcome
        if outcome == RESTARTED:
            _restart_model(k, model_p, model_n, model_s, model_k)
    if n[DELAY] > 0:
        last = k[LATE_TICKS] - 1
        for i in range(k[LATE_TICKS]):
            stamped = i == last and outcome != UNSETTLED
            _run_late(p, n, s, k, model_p, model_n, model_s, model_k, i, stamped, stamp, current)
        reason = k[LATE_REASON]
    else:
        reason = _run_now(s, k, model_p, model_n, model_s, model_k, current)
    if outcome == UNSETTLED and reason == OK:
        reason = WARMING_UP
    elif reason == UNBOUNDED:
        k[CAUSE] = UNBOUNDED
    if reason == OK and n[DELAY] == 0:
        s[FORCE] = run_force(model_p, model_s, s[AHEAD])
    k[REASON] = reason
    return reason


def _run_now(
    s: Floats, k: Ints, model_p: Floats, model_n: Ints, model_s: Floats, model_k: Ints, current: float
) -> int:  # fmt: skip
    """Run the ticks that the sample completes; lost ones lie on the line between their neighbours."""
    count = k[TICKS]
    for i in range(1, count):
        share = float(i) / float(count)
        x = s[OLD_POSITION] + share * (s[BANK_POSITION] - s[OLD_POSITION])
        v = s[OLD_SPEED] + share * (s[BANK_SPEED] - s[OLD_SPEED])
        if not run_advance(model_p, model_n, model_s, model_k, x, v, current):
            return UNBOUNDED
    if count > 0 and not run_advance(model_p, model_n, model_s, model_k, s[BANK_POSITION], s[BANK_SPEED], current):
        return UNBOUNDED
    return OK if model_k[WAIT] < 0 else WARMING_UP


def _run_late(
    p: Floats, n: Ints, s: Floats, k: Ints, model_p: Floats, model_n: Ints, model_s: Floats, model_k: Ints,
    i: int, stamped: bool, stamp: int, current: float,
) -> None:  # fmt: skip
    """Put a new tick into the ring, and run the oldest one if its speed is known now; a lost tick has no stamp."""
    length = n[DELAY] + 1
    slot = k[RING_NEXT]
    values = n[RING_VALUES] + RING_WIDTH * slot
    stamps = n[RING_STAMPS] + RING_WIDTH * slot
    s[values] = current
    s[values + 1] = s[AHEAD]
    k[stamps] = stamp
    k[stamps + 1] = 1 if stamped else 0
    slot = slot + 1 if slot + 1 < length else 0
    k[RING_NEXT] = slot
    if k[RING_COUNT] < length:
        k[RING_COUNT] += 1
    if k[n[LATE_KNOWN] + i] == 0:
        return
    if k[RING_COUNT] < length:
        slot = 0
    _run_oldest(p, n, s, k, model_p, model_n, model_s, model_k, i, slot)


def _run_oldest(
    p: Floats, n: Ints, s: Floats, k: Ints, model_p: Floats, model_n: Ints, model_s: Floats, model_k: Ints,
    i: int, slot: int,
) -> None:  # fmt: skip
    """Run late tick i with what waits at `slot` of the ring, and note its estimate."""
    position = s[n[LATE_AT] + 2 * i]
    speed = s[n[LATE_AT] + 2 * i + 1]
    values = n[RING_VALUES] + RING_WIDTH * slot
    stamps = n[RING_STAMPS] + RING_WIDTH * slot
    current = s[values]
    ahead = s[values + 1]
    if not run_advance(model_p, model_n, model_s, model_k, position, speed, current):
        k[LATE_REASON] = UNBOUNDED
    elif model_k[WAIT] >= 0:
        k[LATE_REASON] = WARMING_UP
    else:
        k[LATE_REASON] = OK
        if k[stamps + 1] != 0 and k[LATE_COUNT] <= n[DELAY]:  # as always: no more can wait
            at = n[LATE_VALUES] + LATE_WIDTH * k[LATE_COUNT]
            s[at] = position + ahead * p[TICK_S] * speed
            s[at + 1] = speed
            s[at + 2] = run_force(model_p, model_s, ahead)
            s[at + 3] = run_half_width(model_p, model_n, model_s)
            k[n[LATE_STAMPS] + k[LATE_COUNT]] = k[stamps]
            k[LATE_COUNT] += 1


def estimator_skip_late(n: Ints, s: Floats, k: Ints, until: int) -> None:
    """Give no late estimates up to this stamp [ns]: another estimator has given them."""
    for i in range(n[DELAY] + 1):
        stamps = n[RING_STAMPS] + RING_WIDTH * i
        if k[stamps] <= until:
            k[stamps + 1] = 0
    kept = 0
    for i in range(k[LATE_COUNT]):
        if k[n[LATE_STAMPS] + i] > until:
            k[n[LATE_STAMPS] + kept] = k[n[LATE_STAMPS] + i]
            for j in range(LATE_WIDTH):
                s[n[LATE_VALUES] + LATE_WIDTH * kept + j] = s[n[LATE_VALUES] + LATE_WIDTH * i + j]
            kept += 1
    k[LATE_COUNT] = kept


def check_estimator(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether tracker and estimator stay within arrays p, n, s and k of these sizes."""
    if not check_tracker(p, n, numbers, counts, states, flags) or counts < N_ESTIMATOR_END:
        return False
    if states < S_ESTIMATOR_END or flags < K_ESTIMATOR_END:
        return False
    length = n[DELAY] + 1
    fits = lies_within(n[RING_VALUES], RING_WIDTH * length, S_ESTIMATOR_END, states)
    fits = fits and lies_within(n[RING_STAMPS], RING_WIDTH * length, K_ESTIMATOR_END, flags)
    fits = fits and lies_within(n[LATE_VALUES], LATE_WIDTH * length, S_ESTIMATOR_END, states)
    return fits and lies_within(n[LATE_STAMPS], length, K_ESTIMATOR_END, flags)


def check_model(
    p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int,
    model_p: Floats, model_n: Ints, model_numbers: int, model_counts: int, model_states: int, model_flags: int,
) -> bool:  # fmt: skip
    """Return whether `estimator_step` stays within all arrays of these sizes, whatever its samples are."""
    small = counts > 0 and are_indices(n, 0, counts, 1, -MAX_COUNT, MAX_COUNT)  # so that no sum of them overflows
    small = small and model_counts > 0 and are_indices(model_n, 0, model_counts, 1, -MAX_COUNT, MAX_COUNT)
    if not (small and check_estimator(p, n, numbers, counts, states, flags)):
        return False
    return check_run(model_p, model_n, model_numbers, model_counts, model_states, model_flags)
