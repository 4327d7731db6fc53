"""How the messages of a topic arrive: their period, ages and jitter; what is missing, repeated or out of line.

It is in the subset of docs/tick.md, and `ces_identify.export.cpp_sources` prints it for the C++ node. s and k hold the
counts of a signal, losses_k those of its topic. Stamps, times and the period are in ns. The period is learnt from the
stamps and followed. An interval from 0.5 to 1.5 periods is usual and takes a few additions. A late message,
stamped before the newest, cancels one that is missing. A stamp further back, or sent after it arrived as the others are
stamped, is out of line: it does not count, unless the next one confirms it.
"""

from math import floor, sqrt

from ces_observer.tick.arrays import Floats, Ints

# losses_k: messages in a full queue; whether the messages are numbered, and were before; messages lost by their
# numbers; those of them that the node's own queue dropped; the last number, and how often it did not rise
QUEUE_DEPTH, NUMBERED, LOST, OVERFLOWED, WAS_NUMBERED, LAST_NUMBER, SWITCHES, K_LOSSES_END = range(8)

# s: the period, 0 if it is unknown; sums of the usual intervals' deviations from it, of their squares, and of ages; of
# the last window: mean deviation, jitter, mean age
ARRIVAL_PERIOD, DEVIATIONS, SQUARES, AGES, MEAN_DEVIATION, JITTER, MEAN_AGE, S_ARRIVALS_END = range(8)

# k: the newest stamp, the last one if it was out of line, the usual age, whether these are known; the mean age of the
# last window, if it had one; the largest age; messages at usual intervals, others, and the usual ones at the last of
# those and when the period was set; messages missing in a row of others, and its length; messages missing, late,
# repeated; interruptions; messages before those whose ages count; missing, less late, at the last roll; messages whose
# ages the last window had, and the largest; how many intervals are learnt, and they, rising
(
    NEWEST,
    DOUBTFUL,
    IS_DOUBTFUL,
    USUAL_AGE,
    HAS_USUAL_AGE,
    LAST_AGE,
    HAS_LAST_AGE,
    MAX_AGE,
    USUAL,
    RARE,
    STREAK_AT,
    UNMEASURED,
    PENDING,
    STREAK,
    MISSING,
    LATE,
    DUPLICATES,
    INTERRUPTIONS,
    AGED,
    DROPPED,
    WINDOW_AGED,
    WINDOW_MAX_AGE,
    LEARNT,
    STEPS,
) = range(24)
LEARN = 11  # intervals to learn the period, and unusual ones in a row after which it is learnt again
K_ARRIVALS_END = STEPS + LEARN

FULL_SHARE = 0.9  # of the queue's length in time: the period is an average
MAX_SWITCHES = 20  # more show that several publishers share the topic
BACK = 50000000.0  # [ns] and
BACK_PERIODS = 20.0  # a stamp further back than both: clock set back, not late
SILENCE = 1000000000.0  # [ns] and
SILENCE_PERIODS = 10.0  # longer than both: silence, not lost messages
MAX_LOST_SHARE = 0.5  # of messages while learning; a period that implies more is rejected
LOWEST_AGE = -4611686018427387904  # [ns]


def losses_take_number(losses_k: Ints, is_numbered: bool, number: int) -> bool:
    """Take the number of the next message; return whether this topic's numbers can be used."""
    if not is_numbered or losses_k[SWITCHES] > MAX_SWITCHES:
        losses_k[NUMBERED] = 0
        losses_k[LOST] = 0
        return False
    losses_k[NUMBERED] = 1
    if losses_k[WAS_NUMBERED] != 0:
        if number > losses_k[LAST_NUMBER]:
            losses_k[LOST] += number - losses_k[LAST_NUMBER] - 1
        else:  # another publisher, or one that was started again
            losses_k[SWITCHES] += 1
    losses_k[WAS_NUMBERED] = 1
    losses_k[LAST_NUMBER] = number
    return True


def losses_take_gap(losses_k: Ints, missing: int, waited: int, period: float) -> bool:
    """Count samples as overflowed if the message after them had waited for as long as a full queue; return this."""
    if losses_k[NUMBERED] != 0 and missing > losses_k[LOST] - losses_k[OVERFLOWED]:
        missing = losses_k[LOST] - losses_k[OVERFLOWED]
    if missing <= 0 or float(waited) < FULL_SHARE * float(losses_k[QUEUE_DEPTH]) * period:
        return False
    losses_k[OVERFLOWED] += missing
    return True


def arrivals_reset(s: Floats, k: Ints) -> None:
    """Forget all messages."""
    for i in range(S_ARRIVALS_END):
        s[i] = 0.0
    for i in range(K_ARRIVALS_END):
        k[i] = 0
    k[MAX_AGE] = LOWEST_AGE


def arrivals_take(s: Floats, k: Ints, losses_k: Ints, stamp: int, now: int) -> None:
    """Count a message with this stamp that arrived at `now` of the node's clock."""
    age = now - stamp
    step = stamp - k[NEWEST]
    deviation = float(step) - s[ARRIVAL_PERIOD]
    half = 0.5 * s[ARRIVAL_PERIOD]
    if -half < deviation < half:
        k[NEWEST] = stamp
        k[USUAL] += 1
        s[DEVIATIONS] += deviation
        s[SQUARES] += deviation * deviation
    else:
        age = _take_rare(s, k, losses_k, stamp, step, age)
    s[AGES] += float(age)
    if age > k[MAX_AGE]:
        k[MAX_AGE] = age


def arrivals_roll(s: Floats, k: Ints) -> None:
    """Close a window: MEAN_DEVIATION, JITTER, MEAN_AGE, WINDOW_MAX_AGE and DROPPED are its figures."""
    if k[USUAL] != k[STREAK_AT]:
        _count_pending(k)
    if k[MISSING] < k[LATE] + k[DROPPED]:
        k[MISSING] = k[LATE] + k[DROPPED]
    k[DROPPED] = k[MISSING] - k[LATE]
    s[MEAN_DEVIATION] = 0.0
    s[JITTER] = 0.0
    count = k[USUAL] - k[UNMEASURED]
    if count > 0:
        mean = s[DEVIATIONS] / float(count)
        variance = s[SQUARES] / float(count) - mean * mean
        s[MEAN_DEVIATION] = mean
        s[JITTER] = sqrt(variance) if variance > 0.0 else 0.0
    k[WINDOW_AGED] = k[USUAL] + k[RARE] - k[AGED]
    s[MEAN_AGE] = 0.0
    k[WINDOW_MAX_AGE] = 0
    if k[WINDOW_AGED] > 0:
        s[MEAN_AGE] = s[AGES] / float(k[WINDOW_AGED])
        k[WINDOW_MAX_AGE] = k[MAX_AGE]
        newest = floor(s[MEAN_AGE] + 0.5)
        # A window with a stall is none of usual ages.
        k[USUAL_AGE] = k[LAST_AGE] if k[HAS_LAST_AGE] != 0 and k[LAST_AGE] < newest else newest
        k[HAS_USUAL_AGE] = 1
        k[LAST_AGE] = newest
    k[HAS_LAST_AGE] = 1 if k[WINDOW_AGED] > 0 else 0
    if s[ARRIVAL_PERIOD] > 0.0:
        _set_period(s, k, s[ARRIVAL_PERIOD] + s[MEAN_DEVIATION])
    _reset_ages(s, k)


def arrivals_restart_ages(s: Floats, k: Ints) -> None:
    """Forget the ages of messages: the node's clock was set."""
    _reset_ages(s, k)
    k[HAS_USUAL_AGE] = 0
    k[HAS_LAST_AGE] = 0


def _reset_ages(s: Floats, k: Ints) -> None:
    k[AGED] = k[USUAL] + k[RARE]
    s[AGES] = 0.0
    k[MAX_AGE] = LOWEST_AGE


def _count_periods(step: int, period: float) -> int:
    return floor(float(step) / period + 0.5)


def _is_silence(s: Floats, step: int) -> bool:
    """Return whether an interval is longer than lost messages explain."""
    return float(step) > SILENCE and float(step) > SILENCE_PERIODS * s[ARRIVAL_PERIOD]


def _take_rare(s: Floats, k: Ints, losses_k: Ints, stamp: int, step: int, age: int) -> int:
    """Count a message whose stamp is not about one period after the newest; return its age, or the usual one.

    The usual age, that of the first message until a window is closed, replaces one that means nothing.
    """
    k[RARE] += 1
    if k[HAS_USUAL_AGE] == 0:
        k[USUAL_AGE] = age
        k[HAS_USUAL_AGE] = 1
    if k[USUAL] + k[RARE] == 1:
        k[NEWEST] = stamp
        return age
    back = BACK_PERIODS * s[ARRIVAL_PERIOD]
    back = -(back if back > BACK else BACK)
    waited = age - k[USUAL_AGE]
    if float(step) < back or (step > 0 and float(waited) < back):
        return _take_doubtful(s, k, stamp, step, age)
    k[IS_DOUBTFUL] = 0
    if step == 0:
        k[DUPLICATES] += 1
    elif step < 0:
        k[LATE] += 1
    else:
        k[NEWEST] = stamp
        missing = _count_periods(step, s[ARRIVAL_PERIOD]) - 1 if s[ARRIVAL_PERIOD] > 0.0 else 0
        if losses_take_gap(losses_k, missing, waited, s[ARRIVAL_PERIOD]) or not _is_silence(s, step):
            _take_unusual(s, k, step)
        else:
            k[INTERRUPTIONS] += 1
    return age


def _take_doubtful(s: Floats, k: Ints, stamp: int, step: int, age: int) -> int:
    """Count a stamp out of line, once; the next one beside it shows that the clock was set."""
    is_confirmed = k[IS_DOUBTFUL] != 0 and not _is_silence(s, abs(stamp - k[DOUBTFUL]))
    if step < 0 or is_confirmed:  # the gap before it was none
        k[PENDING] = 0
        k[STREAK] = 0
    if not is_confirmed:
        k[DOUBTFUL] = stamp
        k[IS_DOUBTFUL] = 1
        k[INTERRUPTIONS] += 1
        return k[USUAL_AGE]
    arrivals_restart_ages(s, k)
    k[AGED] -= 1  # this message counts
    k[NEWEST] = stamp
    k[IS_DOUBTFUL] = 0
    k[USUAL_AGE] = age
    k[HAS_USUAL_AGE] = 1
    return age


def _take_unusual(s: Floats, k: Ints, step: int) -> None:
    """Learn from an interval, or count the messages missing in it; a short one cancels a long one."""
    if s[ARRIVAL_PERIOD] <= 0.0:
        _learn(s, k, step)
        return
    if k[USUAL] != k[STREAK_AT]:
        _count_pending(k)
    k[PENDING] += _count_periods(step, s[ARRIVAL_PERIOD]) - 1
    k[STREAK] += 1
    if k[STREAK] < LEARN:
        return
    if abs(k[PENDING]) > LEARN // 2:  # nothing was lost: the rate has changed
        k[PENDING] = 0
        k[STREAK] = 0
        k[LEARNT] = 0
        _set_period(s, k, 0.0)
    else:
        _count_pending(k)


def _count_pending(k: Ints) -> None:
    """Count the pending messages: usual intervals have ended the row of unusual ones."""
    k[MISSING] += k[PENDING]
    k[PENDING] = 0
    k[STREAK] = 0
    k[STREAK_AT] = k[USUAL]


def _learn(s: Floats, k: Ints, step: int) -> None:
    """Put an interval among the learnt ones, which rise; the last one sets the period."""
    i = STEPS + k[LEARNT]
    while i > STEPS and k[i - 1] > step:
        k[i] = k[i - 1]
        i -= 1
    k[i] = step
    k[LEARNT] += 1
    if k[LEARNT] < LEARN:
        return
    k[LEARNT] = 0
    period = float(k[STEPS + LEARN // 2])
    total = 0.0
    lost = 0
    for j in range(LEARN):
        total += float(k[STEPS + j])
        lost += _count_periods(k[STEPS + j], period) - 1
    if float(lost) > MAX_LOST_SHARE * float(lost + LEARN):
        period = total / float(LEARN)
        lost = 0
    k[MISSING] += lost if lost > 0 else 0
    _set_period(s, k, period)


def _set_period(s: Floats, k: Ints, period: float) -> None:
    """Count relative to this period from now on; 0 while it is unknown."""
    s[ARRIVAL_PERIOD] = float(floor(period + 0.5))
    s[DEVIATIONS] = 0.0
    s[SQUARES] = 0.0
    k[UNMEASURED] = k[USUAL]
    k[STREAK_AT] = k[USUAL]
