"""The bank: positions on uniform ticks in; position and speed, known at once and after a stated delay, out.

Each mode is the stationary Kalman filter (`ces_observer.bank_design`) of strokes up to one frequency; the speed has the
RMS of the identification recordings in all of them. The output is the mean of the modes, weighted by how well each
predicts (multiple-model estimator with switching; Bar-Shalom, Li & Kirubarajan, Estimation with Applications to
Tracking and Navigation, sec. 11.6). The likelihood is Student's t, so that one wild sample does not decide for long.

Tests find each mode stable at constant shifts of the samples and numbers of lost ticks (`ces_observer.bank_design`),
but no fixed gains are so for every sequence of intervals. So a mode whose innovation is 300 times its spread restarts
at the mean, which keeps the states small in every sequence tried; this is not proved.

After `delay` ticks, the innovations that came later have corrected the speed (fixed-lag smoothing). Innovations that
come later still correct it afterwards, discounted with AFTER_S: a damper's force follows the speed within milliseconds,
so that a correction which is a tick late still makes up for most of the error.

A mode is held in the companion form of its speed,

    x' = x + b0 v + b1 z1 + b2 z2 + b3 z3,   v' = a1 v + z1,   z1' = a2 v + z2,   z2' = a3 v + z3,   z3' = a4 v,

plus gains times its innovation. A measured speed or acceleration is a second measurement, and an offset of it the sixth
state. `ces_observer.estimator` fills p and n.
"""

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.model import LARGEST, are_between, lies_within

# p: the time of a tick [s]; the shares of its weight that a mode keeps and that it gets from all of them
TICK_S, STAY, LEAVE, P_TRACKER = range(4)

# n: the delay [ticks], how many modes and spans [ticks] there are, whether a motion is measured beside the position;
# where tables begin: the spans in n; in p what measurements see by shift and mode, the gains by span, shift and mode,
# the likelihood by span and mode, the companion forms by mode, and the smoothing by mode and measurement; in s the
# modes, the ring, how many numbers both have, and a copy of them
(
    DELAY, MODES, SPANS, MEASURES_MOTION, SPAN_TABLE, SEEN, GAINS, LIKELIHOODS, COMPANIONS, SMOOTHING,
    MODE_STATES, RING, BANK_STATES, SAVED, N_TRACKER,
) = range(15)  # fmt: skip

# s: position [m] and speed [m/s] at the newest tick, as predicted for the next one, and `delay` ticks ago as they are
# known now; the sum of the weights; a copy of all these
(
    BANK_POSITION, BANK_SPEED, NEXT_POSITION, NEXT_SPEED, LATE_POSITION, LATE_SPEED, TOTAL, SAVED_POSITION,
) = range(8)  # fmt: skip
S_TRACKER = 2 * SAVED_POSITION

# k: ticks since the restart, and a copy
BANK_TICKS, SAVED_TICKS, K_TRACKER = range(3)

# a mode's state in s: x [m], v [m/s], z1, z2, z3, the offset of the motion, its weight, and whether it must restart
MODE_X, MODE_V, MODE_Z1, MODE_Z2, MODE_Z3, MODE_OFFSET, MODE_WEIGHT, MODE_LOST, MODE_WIDTH = range(9)

# a mode's companion form in p
A1, A2, A3, A4, B0, B1, B2, B3, COMPANION_WIDTH = range(9)

# what a mode's measurements see, in p: weights of v, z1, z2, z3 in the position, and in the motion if it is measured
SEEN_V, SEEN_Z1, SEEN_Z2, SEEN_Z3, SEEN_WIDTH = range(5)
FELT_V, FELT_Z1, FELT_Z2, FELT_Z3, BOTH_SEEN_WIDTH = range(SEEN_WIDTH, SEEN_WIDTH + 5)

# a mode's gains in p: of the outputs and the next states on its innovation, and on that of the motion if it is measured
GAIN_POSITION, GAIN_SPEED, GAIN_X, GAIN_V, GAIN_Z1, GAIN_Z2, GAIN_Z3, GAINS_WIDTH = range(8)
(
    FELT_POSITION, FELT_SPEED, FELT_X, FELT_GAIN_V, FELT_GAIN_Z1, FELT_GAIN_Z2, FELT_GAIN_Z3, GAIN_OFFSET, FELT_OFFSET,
    BOTH_WIDTH,
) = range(GAINS_WIDTH, GAINS_WIDTH + 10)  # fmt: skip

# a mode's likelihood in p: its height and sharpness, and two more parts of that if a motion is measured
HEIGHT, SHARPNESS, LIKELIHOOD_WIDTH = range(3)
SHARPNESS_BOTH, SHARPNESS_MOTION, BOTH_LIKELIHOOD_WIDTH = range(LIKELIHOOD_WIDTH, LIKELIHOOD_WIDTH + 3)

BINS = 8  # of a tick, to which the gains know the time of a sample
EARLIEST = 12  # [bins] before its tick that the mean of several samples may lie
SHIFT_COUNT = EARLIEST + BINS // 2 + 1  # from EARLIEST before the tick to half a tick after it
LATE_SHIFT = EARLIEST - BINS // 2  # the first of a tick that comes after others without a sample
LATE_SHIFTS = SHIFT_COUNT - LATE_SHIFT
BINS_A_TICK = 8.0  # BINS
FIRST_SHIFT = 12.5  # EARLIEST, and half a bin: a bin lies around its middle
LOST = 1e4  # 1 + e' sharpness e of an innovation that is 300 times its spread
MAX_MODES = 64
MAX_SPANS = 64
MAX_DELAY_TICKS = 10_000


def bank_reset(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float) -> None:
    """Restart at `position` [m] with a constant `speed` [m/s]."""
    s[BANK_POSITION] = position
    s[BANK_SPEED] = speed
    s[NEXT_POSITION] = position + p[TICK_S] * speed
    s[NEXT_SPEED] = speed
    s[TOTAL] = 1.0
    k[BANK_TICKS] = 0
    for i in range(n[MODES]):
        here = n[MODE_STATES] + i * MODE_WIDTH
        make_steady(p, n, s, i, 0.0)
        s[here + MODE_WEIGHT] = 1.0 / float(n[MODES])
        s[here + MODE_LOST] = 0.0
        if n[DELAY] > 0:
            keep_tick(n, s, k, i, speed, 0.0, 0.0)
    if n[DELAY] > 0:
        s[n[RING]] = position


def make_steady(p: Floats, n: Ints, s: Floats, mode: int, offset: float) -> None:
    """Set a mode to the predicted mean, with a speed that stays as it is until it decays."""
    form = n[COMPANIONS] + mode * COMPANION_WIDTH
    here = n[MODE_STATES] + mode * MODE_WIDTH
    speed = s[NEXT_SPEED]
    z1 = speed - p[form + A1] * speed
    z2 = z1 - p[form + A2] * speed
    s[here + MODE_X] = s[NEXT_POSITION]
    s[here + MODE_V] = speed
    s[here + MODE_Z1] = z1
    s[here + MODE_Z2] = z2
    s[here + MODE_Z3] = z2 - p[form + A3] * speed
    s[here + MODE_OFFSET] = offset


def restart_lost_modes(p: Floats, n: Ints, s: Floats) -> None:
    """Restart the modes that are lost at the mean, with the offset of the likeliest."""
    likeliest = n[MODE_STATES]
    for i in range(n[MODES]):
        here = n[MODE_STATES] + i * MODE_WIDTH
        if s[here + MODE_WEIGHT] > s[likeliest + MODE_WEIGHT]:
            likeliest = here
    offset = s[likeliest + MODE_OFFSET]
    for i in range(n[MODES]):
        here = n[MODE_STATES] + i * MODE_WIDTH
        if s[here + MODE_LOST] > 0.0:
            s[here + MODE_LOST] = 0.0
            make_steady(p, n, s, i, offset)


def bank_save(n: Ints, s: Floats, k: Ints) -> None:
    """Keep the present state, for `bank_restore`."""
    copy_numbers(s, 0, SAVED_POSITION, SAVED_POSITION)
    copy_numbers(s, n[MODE_STATES], n[SAVED], n[BANK_STATES])
    k[SAVED_TICKS] = k[BANK_TICKS]


def bank_restore(n: Ints, s: Floats, k: Ints) -> None:
    """Return to the saved state."""
    copy_numbers(s, SAVED_POSITION, 0, SAVED_POSITION)
    copy_numbers(s, n[SAVED], n[MODE_STATES], n[BANK_STATES])
    k[BANK_TICKS] = k[SAVED_TICKS]


def copy_numbers(s: Floats, source: int, target: int, count: int) -> None:
    """Copy `count` numbers from one place of the state to another."""
    for i in range(count):
        s[target + i] = s[source + i]


def bank_coast(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Advance by a tick without a measurement."""
    k[BANK_TICKS] += 1
    next_x = 0.0
    next_v = 0.0
    form = n[COMPANIONS]
    here = n[MODE_STATES]
    for i in range(n[MODES]):
        speed = s[here + MODE_V]
        z1 = s[here + MODE_Z1]
        z2 = s[here + MODE_Z2]
        z3 = s[here + MODE_Z3]
        if n[DELAY] > 0:
            keep_tick(n, s, k, i, speed, 0.0, 0.0)
        x = s[here + MODE_X] + p[form + B0] * speed + p[form + B1] * z1 + p[form + B2] * z2 + p[form + B3] * z3
        s[here + MODE_X] = x
        v = p[form + A1] * speed + z1
        s[here + MODE_V] = v
        s[here + MODE_Z1] = p[form + A2] * speed + z2
        s[here + MODE_Z2] = p[form + A3] * speed + z3
        s[here + MODE_Z3] = p[form + A4] * speed
        next_x += s[here + MODE_WEIGHT] * x
        next_v += s[here + MODE_WEIGHT] * v
        form += COMPANION_WIDTH
        here += MODE_WIDTH
    total = s[TOTAL]
    note_mean(n, s, k, total, total * s[NEXT_POSITION], total * s[NEXT_SPEED], next_x, next_v)
    if n[DELAY] > 0:
        look_back(p, n, s, k)


def bank_update(
    p: Floats, n: Ints, s: Floats, k: Ints, ticks: int, position: float, shift: float, motion: float
) -> None:
    """Advance to the next tick, `ticks` after the last measured one, and take its measurement.

    `position` [m] is the mean of the samples, `shift` that of their times after the tick, -1.5 to 0.5 ticks; `motion`
    is the signal measured beside it. Gains are those of the nearest bin of the shift, and of the next longer span:
    those of a shorter one are too large.
    """
    k[BANK_TICKS] += 1
    span = 0
    if ticks > 1:
        while span < n[SPANS] - 1 and n[n[SPAN_TABLE] + span] < ticks:
            span += 1
    column = int(BINS_A_TICK * shift + FIRST_SHIFT)
    beside = (shift - float(column - EARLIEST) / BINS_A_TICK) * p[TICK_S]  # [s] beside the middle of the bin
    row = column
    if span > 0:
        row = SHIFT_COUNT + (span - 1) * LATE_SHIFTS + (column - LATE_SHIFT if column > LATE_SHIFT else 0)
    take_measurement(p, n, s, k, row, column, span, position, beside, motion)
    if n[DELAY] > 0:
        look_back(p, n, s, k)


def take_measurement(
    p: Floats, n: Ints, s: Floats, k: Ints, row: int, column: int, span: int, position: float, shift: float,
    motion: float,
) -> None:  # fmt: skip
    """Advance all modes by a tick with a position [m], `shift` [s] beside the middle of its bin, and the motion if any.

    `row`, `column` and `span` are those of the gains, of what is seen, and of the likelihood. The weights are those of
    the last tick, moved a little towards equal ones, times the likelihood of the innovations e and f: height / u^5,
    u = 1 + (e, f)' sharpness (e, f).
    """
    both = n[MEASURES_MOTION] != 0
    modes = n[MODES]
    see_width = BOTH_SEEN_WIDTH if both else SEEN_WIDTH
    gains_width = BOTH_WIDTH if both else GAINS_WIDTH
    like_width = BOTH_LIKELIHOOD_WIDTH if both else LIKELIHOOD_WIDTH
    delay = n[DELAY]
    stay = p[STAY] / s[TOTAL]
    leave = p[LEAVE]
    total = 0.0
    mean_x = 0.0
    mean_v = 0.0
    next_x = 0.0
    next_v = 0.0
    lost = False
    see = n[SEEN] + column * modes * see_width
    at = n[GAINS] + row * modes * gains_width
    like = n[LIKELIHOODS] + span * modes * like_width
    form = n[COMPANIONS]
    here = n[MODE_STATES]
    for i in range(modes):
        x = s[here + MODE_X]
        speed = s[here + MODE_V]
        z1 = s[here + MODE_Z1]
        z2 = s[here + MODE_Z2]
        z3 = s[here + MODE_Z3]
        e = position - x - (p[see + SEEN_V] + shift) * speed
        e = e - p[see + SEEN_Z1] * z1 - p[see + SEEN_Z2] * z2 - p[see + SEEN_Z3] * z3
        f = 0.0
        square = p[like + SHARPNESS] * e * e
        out_x = p[at + GAIN_POSITION] * e
        out_v = p[at + GAIN_SPEED] * e
        to_x = p[at + GAIN_X] * e
        to_v = p[at + GAIN_V] * e
        to_z1 = p[at + GAIN_Z1] * e
        to_z2 = p[at + GAIN_Z2] * e
        to_z3 = p[at + GAIN_Z3] * e
        if both:
            felt = p[see + FELT_V] * speed + p[see + FELT_Z1] * z1 + p[see + FELT_Z2] * z2 + p[see + FELT_Z3] * z3
            f = motion - (felt + s[here + MODE_OFFSET])
            square = square + p[like + SHARPNESS_BOTH] * e * f + p[like + SHARPNESS_MOTION] * f * f
            if square < -0.5:
                square = 0.0  # never, but for numbers that no design gives
            out_x += p[at + FELT_POSITION] * f
            out_v += p[at + FELT_SPEED] * f
            to_x += p[at + FELT_X] * f
            to_v += p[at + FELT_GAIN_V] * f
            to_z1 += p[at + FELT_GAIN_Z1] * f
            to_z2 += p[at + FELT_GAIN_Z2] * f
            to_z3 += p[at + FELT_GAIN_Z3] * f
            s[here + MODE_OFFSET] += p[at + GAIN_OFFSET] * e + p[at + FELT_OFFSET] * f
        u = 1.0 + square
        square = u * u
        weight = (leave + stay * s[here + MODE_WEIGHT]) * p[like + HEIGHT] / (square * square * u)
        total += weight
        mean_x += weight * (x + out_x)
        mean_v += weight * (speed + out_v)
        if delay > 0:
            keep_tick(n, s, k, i, speed, e, f)
        x = x + p[form + B0] * speed + p[form + B1] * z1 + p[form + B2] * z2 + p[form + B3] * z3 + to_x
        v = p[form + A1] * speed + z1 + to_v
        s[here + MODE_X] = x
        s[here + MODE_V] = v
        s[here + MODE_Z1] = p[form + A2] * speed + z2 + to_z1
        s[here + MODE_Z2] = p[form + A3] * speed + z3 + to_z2
        s[here + MODE_Z3] = p[form + A4] * speed + to_z3
        s[here + MODE_WEIGHT] = weight
        next_x += weight * x
        next_v += weight * v
        if u > LOST:
            s[here + MODE_LOST] = 1.0
            lost = True
        see += see_width
        at += gains_width
        like += like_width
        form += COMPANION_WIDTH
        here += MODE_WIDTH
    note_mean(n, s, k, total, mean_x, mean_v, next_x, next_v)
    if lost:
        restart_lost_modes(p, n, s)


def note_mean(n: Ints, s: Floats, k: Ints, total: float, x: float, v: float, next_x: float, next_v: float) -> None:
    """Set the mean of the modes from sums over them, times their weights."""
    if not total > 0.0:
        total = 1.0  # never, but for numbers that no design gives
    s[TOTAL] = total
    s[BANK_POSITION] = x / total
    s[BANK_SPEED] = v / total
    s[NEXT_POSITION] = next_x / total
    s[NEXT_SPEED] = next_v / total
    if n[DELAY] > 0:
        s[n[RING] + k[BANK_TICKS] % (n[DELAY] + 1)] = s[BANK_POSITION]


def keep_tick(n: Ints, s: Floats, k: Ints, mode: int, speed: float, e: float, f: float) -> None:
    """Keep a mode's predicted speed [m/s] and innovations at this tick in the ring.

    The ring has the positions, then for each mode the speeds and twice the innovations of the last `delay` + 1 ticks.
    Each innovation is written twice, so that the last ones always lie in a row.
    """
    length = n[DELAY] + 1
    slot = k[BANK_TICKS] % length
    if n[MEASURES_MOTION] != 0:
        at = n[RING] + length * (1 + 5 * mode) + slot
        s[at + 3 * length] = f
        s[at + 4 * length] = f
    else:
        at = n[RING] + length * (1 + 3 * mode) + slot
    s[at] = speed
    s[at + length] = e
    s[at + 2 * length] = e


def look_back(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Set position and speed of the tick `delay` ticks ago, by all innovations since."""
    length = n[DELAY] + 1
    oldest = (k[BANK_TICKS] + 1) % length
    measurements = 2 if n[MEASURES_MOTION] != 0 else 1
    gains = n[SMOOTHING]
    kept = n[RING] + length
    here = n[MODE_STATES]
    total = 0.0
    for _mode in range(n[MODES]):
        speed = s[kept + oldest]
        kept += length
        for _measurement in range(measurements):
            part = 0.0
            errors = kept + oldest
            for i in range(length):
                part += p[gains + i] * s[errors + i]
            speed += part
            gains += length
            kept += 2 * length
        total += s[here + MODE_WEIGHT] * speed
        here += MODE_WIDTH
    s[LATE_POSITION] = s[n[RING] + oldest]
    s[LATE_SPEED] = total / s[TOTAL]


def check_bank(p: Floats, n: Ints, numbers: int, counts: int, named: int, states: int) -> bool:
    """Return whether the bank stays within arrays p, n and s of these sizes, and can divide by its weights.

    Its state must lie behind the `named` places of s.
    """
    modes = n[MODES]
    spans = n[SPANS]
    if not (1 <= modes <= MAX_MODES and 1 <= spans <= MAX_SPANS and 0 <= n[DELAY] <= MAX_DELAY_TICKS):
        return False
    length = n[DELAY] + 1
    measurements = 2 if n[MEASURES_MOTION] != 0 else 1
    rows = (SHIFT_COUNT + (spans - 1) * LATE_SHIFTS) * modes
    gains = BOTH_WIDTH if measurements == 2 else GAINS_WIDTH
    seen = BOTH_SEEN_WIDTH if measurements == 2 else SEEN_WIDTH
    likelihood = BOTH_LIKELIHOOD_WIDTH if measurements == 2 else LIKELIHOOD_WIDTH
    size = modes * MODE_WIDTH
    if n[DELAY] > 0:
        size += length * (1 + modes * (1 + 2 * measurements))
    fits = n[BANK_STATES] == size and n[RING] == n[MODE_STATES] + modes * MODE_WIDTH and p[TICK_S] > 0.0
    fits = fits and lies_within(n[MODE_STATES], size, named, states) and lies_within(n[SAVED], size, named, states)
    fits = fits and lies_within(n[SPAN_TABLE], spans, 0, counts) and lies_within(n[GAINS], rows * gains, 0, numbers)
    fits = fits and lies_within(n[SEEN], SHIFT_COUNT * modes * seen, 0, numbers)
    fits = fits and lies_within(n[LIKELIHOODS], spans * modes * likelihood, 0, numbers)
    fits = fits and lies_within(n[COMPANIONS], modes * COMPANION_WIDTH, 0, numbers)
    fits = fits and lies_within(n[SMOOTHING], modes * length * measurements, 0, numbers)
    return fits and are_between(p, n[LIKELIHOODS] + SHARPNESS, spans * modes, likelihood, 0.0, LARGEST)
