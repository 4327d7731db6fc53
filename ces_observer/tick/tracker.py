"""The tracker: turns irregular position samples into the model's uniform ticks, causally.

Stamps [ns] and positions [m] go in; each sample yields zero or more ticks (position, speed at multiples of 1/rate).
A sample belongs to the next tick, at most half a period after it; the bank takes it where it is, so a jittered stream
at the model's rate gives one tick per sample without delay. Further samples before that tick are averaged. Lost ticks
lie on the line between their neighbours. A silence longer than the longest gap is never bridged. With a delay, each
tick also yields position and speed of the tick that long before, as they are known now.

A position is plausible within the stroke, and within OUTLIER_M of its prediction. After lost samples it is also
plausible if the piston can have reached it: to within OUTLIER_M plus the effect of the largest change of speed while
no sample came. The largest change is a multiple of the RMS speed of the identification recordings, from half that in
one direction to half in the other, and takes as long as the bank settles. Until it has settled after such a sample or a
restart, its speed may be as wrong, so the change is allowed at once.

This rejects every spike or jump beyond OUTLIER_M while no samples are lost and, after a gap, positions that no
stroke could reach. It accepts a wrong position within reach, which after about ten lost samples is much of a damper's
stroke; the true positions after it are then rejected until they are within reach or accepted as a jump.

After a position that only a change of speed explains, or a silence of several settling times, speed and force are
uncertain: samples are UNSETTLED for that long. They are used, but their forces must not be published.
"""

from math import floor, isfinite

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.bank import (
    BANK_POSITION, BANK_SPEED, BANK_TICKS, DELAY, K_TRACKER, LATE_POSITION, LATE_SPEED, N_TRACKER, NEXT_POSITION,
    NEXT_SPEED, P_TRACKER, S_TRACKER, TICK_S, bank_coast, bank_reset, bank_restore, bank_save, bank_update, check_bank,
)  # fmt: skip
from ces_observer.tick.model import lies_within

# p: the rate [ticks/ns]; how far a position may be from its prediction [m]; the stroke [m]; the largest change of speed
# [m/s]; the interval after which samples were lost [s]; how long the bank settles, and the model after it [s and ticks]
(
    TICKS_PER_NS, OUTLIER_M, STROKE_LOW, STROKE_HIGH, LARGEST_CHANGE, OVERDUE_S, SETTLING_S, SETTLING_TICKS, DOUBT_S,
    DOUBT_TICKS, P_ESTIMATOR,
) = range(P_TRACKER, P_TRACKER + 11)  # fmt: skip

# n: the longest gap [ns] that is bridged, whether the measured motion is the speed, and where the late ticks begin in s
# (position, speed) and k (whether they are known)
MAX_GAP_NS, MEASURES_SPEED, LATE_AT, LATE_KNOWN, N_ESTIMATOR = range(N_TRACKER, N_TRACKER + 5)

# s: how far a sample lay from its prediction [m], if it had one; position [m] and speed [m/s] at the last accepted
# sample, and its time after the last tick [ticks]; if it completed several ticks, the tick before them; the time of the
# last accepted sample since the restart, and when bank and model have settled [ticks]; of samples rejected since then,
# the last interval and the time lost [s]; of samples that wait for the next tick, the sums and the newest motion
(
    INNOVATION, TRACK_POSITION, TRACK_SPEED, AHEAD, OLD_POSITION, OLD_SPEED, TAU, SETTLED_TAU, DOUBTED_TAU,
    LAST_INTERVAL, LOST_S, SUM_POSITION, SUM_SHIFT, WAITING_MOTION, S_ESTIMATOR,
) = range(S_TRACKER, S_TRACKER + 15)  # fmt: skip

# k: ticks and late ticks that the last sample has brought; whether there was a sample, the stamps [ns] of the restart
# and of the last accepted one, the last tick, samples rejected since, and samples that wait for the next tick
(
    TICKS, LATE_TICKS, TRACKING, ORIGIN, LAST_STAMP, LAST_TICK, REJECTED, WAITING, K_ESTIMATOR,
) = range(K_TRACKER, K_TRACKER + 9)  # fmt: skip

# outcomes, in the order of `ces_observer.reasons.REASONS`; some are those of the estimator
(
    OK, WARMING_UP, NOT_FINITE, OUT_OF_ORDER, OUTLIER, UNBOUNDED, BEYOND_STROKE, RESTARTED, UNSETTLED,
) = range(9)  # fmt: skip

PATIENCE = 10  # outliers in a row after which the jump is accepted
MAX_MOTION = 1e6  # [m/s or m/s2]: a larger one is no measurement, and its likelihood would vanish
MAX_RATE = 2e-4  # [ticks/ns]: the time of any stamp keeps its fraction of a tick
MAX_LOST_TICKS = 1_000_000
IMPLAUSIBLE, PLAUSIBLE, UNSETTLING, DOUBTFUL = range(4)  # a position


def tracker_reset(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Forget every sample."""
    for i in range(TRACK_POSITION, S_ESTIMATOR):
        s[i] = 0.0
    for i in range(K_TRACKER, K_ESTIMATOR):
        k[i] = 0


def tracker_advance(p: Floats, n: Ints, s: Floats, k: Ints, stamp: int, position: float, motion: float) -> int:
    """Process a sample [ns, m]; return OK or a reason.

    `motion` is the measured speed [m/s] or acceleration [m/s2], if the sampling names one. TICKS says how many ticks
    the sample completes. The last one is the bank's; tick i of several lies at OLD + i / TICKS (BANK - OLD). The late
    ticks are listed from LATE_AT and LATE_KNOWN on.
    """
    k[TICKS] = 0
    k[LATE_TICKS] = 0
    if not (p[STROKE_LOW] <= position <= p[STROKE_HIGH] and -MAX_MOTION <= motion <= MAX_MOTION):
        return BEYOND_STROKE if isfinite(position) and abs(motion) <= MAX_MOTION else NOT_FINITE
    if k[TRACKING] == 0:
        return tracker_restart(p, n, s, k, stamp, position, motion)
    step = stamp - k[LAST_STAMP]
    if not 0 < step <= n[MAX_GAP_NS]:
        if -n[MAX_GAP_NS] <= step <= 0:
            return OUT_OF_ORDER
        return tracker_restart(p, n, s, k, stamp, position, motion)
    tau = float(stamp - k[ORIGIN]) * p[TICKS_PER_NS]
    newest = floor(tau + 0.5)
    lost = newest - k[LAST_TICK] - 1  # ticks; -1: this sample is not the first of its tick
    if lost > 0:
        coast_lost(p, n, s, k, lost)
    ahead = tau - float(newest)
    shift = ahead if lost >= 0 else ahead - 1.0
    bend = 0.5 * shift * (s[NEXT_SPEED] - s[BANK_SPEED])
    innovation = position - (s[NEXT_POSITION] + shift * p[TICK_S] * (s[NEXT_SPEED] + bend))
    s[INNOVATION] = innovation
    interval = float(step) * 1e-9
    belief = PLAUSIBLE
    if interval > p[OVERDUE_S] or not -p[OUTLIER_M] <= innovation <= p[OUTLIER_M]:
        belief = judge_position(p, s, k, interval, innovation)
        if belief == IMPLAUSIBLE:
            if lost > 0:
                bank_restore(n, s, k)
                k[LATE_TICKS] = 0
            k[REJECTED] += 1
            if k[REJECTED] <= PATIENCE:
                return OUTLIER
            return tracker_restart(p, n, s, k, stamp, position, motion)
    k[REJECTED] = 0
    k[LAST_STAMP] = stamp
    s[TAU] = tau
    s[AHEAD] = ahead
    if lost < 0:
        k[WAITING] += 1
        s[SUM_POSITION] += position
        s[SUM_SHIFT] += shift
        s[WAITING_MOTION] = motion
    else:
        k[TICKS] = lost + 1
        k[LAST_TICK] = newest
        if k[WAITING] > 0:
            take_waiting(p, n, s, k, lost, position, shift, motion)
        else:
            bank_update(p, n, s, k, lost + 1, position, shift, motion)
        if n[DELAY] > 0:
            note_late(n, s, k)
    s[TRACK_POSITION] = s[BANK_POSITION] + ahead * (s[NEXT_POSITION] - s[BANK_POSITION])
    s[TRACK_SPEED] = s[BANK_SPEED] + ahead * (s[NEXT_SPEED] - s[BANK_SPEED])
    if belief != PLAUSIBLE:
        s[SETTLED_TAU] = tau + p[SETTLING_TICKS]
        if belief == DOUBTFUL:
            s[DOUBTED_TAU] = tau + p[DOUBT_TICKS]
    return OK if tau >= s[DOUBTED_TAU] else UNSETTLED


def tracker_restart(p: Floats, n: Ints, s: Floats, k: Ints, stamp: int, position: float, motion: float) -> int:
    """Begin anew with this sample as the first tick; return RESTARTED."""
    tracker_reset(p, n, s, k)
    bank_reset(p, n, s, k, position, motion if n[MEASURES_SPEED] != 0 else 0.0)
    k[TRACKING] = 1
    k[LAST_STAMP] = stamp
    k[ORIGIN] = stamp
    s[SETTLED_TAU] = p[SETTLING_TICKS]
    s[TRACK_POSITION] = position
    s[TRACK_SPEED] = s[BANK_SPEED]
    k[TICKS] = 1
    if n[DELAY] > 0:
        note_late(n, s, k)
    return RESTARTED


def coast_lost(p: Floats, n: Ints, s: Floats, k: Ints, lost: int) -> None:
    """Advance the bank by lost ticks, with the samples that wait for the first; its state before is saved."""
    s[OLD_POSITION] = s[BANK_POSITION]
    s[OLD_SPEED] = s[BANK_SPEED]
    bank_save(n, s, k)
    for i in range(lost):
        if i == 0 and k[WAITING] > 0:
            count = float(k[WAITING])
            bank_update(p, n, s, k, 1, s[SUM_POSITION] / count, s[SUM_SHIFT] / count, s[WAITING_MOTION])
        else:
            bank_coast(p, n, s, k)
        if n[DELAY] > 0:
            note_late(n, s, k)


def take_waiting(
    p: Floats, n: Ints, s: Floats, k: Ints, lost: int, position: float, shift: float, motion: float
) -> None:
    """Take a sample for the tick that it begins, after `lost` ticks, with those that waited for the next tick."""
    if lost > 0:
        bank_update(p, n, s, k, lost, position, shift, motion)  # the others were taken in the first lost tick
    else:
        count = float(k[WAITING] + 1)
        bank_update(p, n, s, k, 1, (s[SUM_POSITION] + position) / count, (s[SUM_SHIFT] + shift) / count, motion)
    k[WAITING] = 0
    s[SUM_POSITION] = 0.0
    s[SUM_SHIFT] = 0.0


def note_late(n: Ints, s: Floats, k: Ints) -> None:
    """Append the tick `delay` ticks before the bank's to the late ticks of this sample."""
    i = k[LATE_TICKS]
    s[n[LATE_AT] + 2 * i] = s[LATE_POSITION]
    s[n[LATE_AT] + 2 * i + 1] = s[LATE_SPEED]
    k[n[LATE_KNOWN] + i] = 1 if k[BANK_TICKS] >= n[DELAY] else 0
    k[LATE_TICKS] = i + 1


def judge_position(p: Floats, s: Floats, k: Ints, interval: float, innovation: float) -> int:
    """Return whether a position is plausible that is late or far from its prediction [m].

    `interval` [s] is that since the last accepted sample. UNSETTLING and DOUBTFUL are plausible positions after which
    the bank, or the model too, must settle.
    """
    if k[REJECTED] == 0:
        s[LAST_INTERVAL] = 0.0
        s[LOST_S] = 0.0
    overdue = interval - s[LAST_INTERVAL] - p[OVERDUE_S]
    if overdue > 0.0:
        s[LOST_S] += overdue
    s[LAST_INTERVAL] = interval
    lost = s[LOST_S]
    if abs(innovation) > p[OUTLIER_M]:
        changed = interval  # [s] during which the speed may have changed by the largest change
        if s[TAU] >= s[SETTLED_TAU]:
            ramp = p[SETTLING_S]
            changed = lost - 0.5 * ramp if lost > ramp else 0.5 * lost * lost / ramp
        reach = p[OUTLIER_M] + p[LARGEST_CHANGE] * changed
        return DOUBTFUL if changed > 0.0 and abs(innovation) <= reach else IMPLAUSIBLE
    if lost > p[DOUBT_S]:
        return DOUBTFUL
    return UNSETTLING if lost > 0.0 else PLAUSIBLE


def check_tracker(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether tracker and bank stay within arrays p, n, s and k of these sizes, whatever the samples are."""
    if numbers < P_ESTIMATOR or counts < N_ESTIMATOR or states < S_ESTIMATOR or flags < K_ESTIMATOR:
        return False
    if not (0.0 < p[TICKS_PER_NS] <= MAX_RATE and p[SETTLING_S] > 0.0 and n[MAX_GAP_NS] > 0):
        return False
    ticks = float(n[MAX_GAP_NS]) * p[TICKS_PER_NS]
    if ticks > float(MAX_LOST_TICKS) or not check_bank(p, n, numbers, counts, S_ESTIMATOR, states):
        return False
    room = int(ticks) + 2 if n[DELAY] > 0 else 0
    fits = lies_within(n[LATE_AT], 2 * room, S_ESTIMATOR, states)
    return fits and lies_within(n[LATE_KNOWN], room, K_ESTIMATOR, flags)
