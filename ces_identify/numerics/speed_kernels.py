"""The tracker and its bank of filters over whole arrays, compiled by Numba: stamps and positions in, uniform ticks out.

`track` repeats `ces_observer.tracker.Tracker` and `ces_observer.speed_bank.SpeedBank` operation by operation.
"""

from __future__ import annotations

from math import floor, log
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ces_data.arrays import F, I
from ces_observer.bank_design import BINS, EARLIEST, SHIFTS, SPEED, BankMode, design_bank, spans_of
from ces_observer.model import Sampling
from ces_observer.speed_bank import LOST, SWITCH_S, SpeedBank
from ces_observer.tracker import DOUBT, MAX_CHANGE, OVERDUE, PATIENCE, SETTLING

STATUS_OK, STATUS_ORDER, STATUS_OUTLIER, STATUS_RESTART, STATUS_UNSETTLED, STATUS_BEYOND = 0, 1, 2, 3, 4, 5
X, V, NEXT_X, NEXT_V, TOTAL = 0, 1, 2, 3, 4  # of the mean
STATES = 6  # of a mode: x, v, z1, z2, z3 and the offset of the motion


class Bank(NamedTuple):
    """The numbers of a bank's m modes as arrays.

    `moves` (m, 8) are a1 to a4 and b0 to b3; `gains` (spans, shifts, m, 28) those on both innovations in turn, of
    position, speed and states, then the sharpness, the height, and the weights of the position and of the motion.
    `smoothing` is (m, 2, delay + 1).
    """

    spans: I
    moves: F
    gains: F
    smoothing: F
    motion: bool
    stay: float
    leave: float
    tick_s: float


class Tracked(NamedTuple):
    """The result of `track` for n samples: m ticks (m, 2) of position [m] and speed [m/s] with their stamps (m,) [ns].

    For each sample: the number of ticks so far, its status, and its time after the last tick [ticks]. `late` (m, 2) are
    the ticks as they are known after the sampling's delay, NaN where they never are; without a delay, the ticks.
    `innovations` (n,) [m] are NaN where there is none. `likelihood` is the mean log likelihood of the measured ticks.
    """

    ticks: F
    stamps_ns: I
    total: I
    status: NDArray[np.int8]
    ahead: F
    late: F
    innovations: F
    likelihood: float


def track(stamps_ns: I, positions: F, sampling: Sampling, motion: F | None = None) -> Tracked:
    """Return the ticks of n finite samples; `motion` (n,) is the signal that the sampling names."""
    tick_s = 1.0 / sampling.rate_Hz
    settling_s = SETTLING * SpeedBank(sampling.stroke).response_s
    limits = np.array(
        [sampling.outlier_m, *sampling.stroke_m, MAX_CHANGE * sampling.speed_m_s, OVERDUE / sampling.rate_Hz]
    )
    return Tracked(
        *_track(
            stamps_ns,
            positions,
            np.zeros(len(stamps_ns)) if motion is None else motion,
            make_bank(sampling),
            sampling.delay_ticks,
            sampling.motion == SPEED,
            round(sampling.max_gap_s * 1e9),
            limits,
            settling_s,
            1.0 / tick_s,
        )
    )


def make_bank(sampling: Sampling) -> Bank:
    """Return the bank of a sampling."""
    modes = design_bank(sampling.stroke, sampling.delay_ticks)
    tick_s = 1.0 / sampling.rate_Hz
    stay = max(0.0, 1.0 - tick_s / SWITCH_S)
    return Bank(
        np.array(spans_of(sampling.stroke)),
        np.array([[*mode.speed, *mode.position] for mode in modes]),
        np.array(
            [
                [[_row(mode, span, at) for mode in modes] for at in range(len(SHIFTS))]
                for span in range(len(modes[0].gains))
            ]
        ),
        np.array([[_column(mode, 0), _column(mode, 1)] for mode in modes]),
        bool(sampling.motion),
        stay,
        (1.0 - stay) / len(modes),
        tick_s,
    )


def _row(mode: BankMode, span: int, at: int) -> list[float]:
    gains = mode.gains[span][at]
    rows = [*(gains.position, gains.speed), *gains.states]
    pairs = [(*row, 0.0)[:2] for row in rows] + [(0.0, 0.0)] * (STATES - len(gains.states))
    sharpness = (*gains.sharpness, 0.0, 0.0)[:3]
    return [*(gain for pair in pairs for gain in pair), *sharpness, gains.height, *mode.measured[at], *mode.motion[at]]


def _column(mode: BankMode, measurement: int) -> list[float]:
    return [(*gains, 0.0)[measurement] for gains in mode.smoothing]


@njit(cache=True, nogil=True)
def _update(
    bank: Bank, span: int, states: F, weights: F, mean: F, kept: F, position: float, shift: float, motion: float,
    now: int,
) -> None:  # fmt: skip
    """Advance all modes by a tick, `span` ticks after the last measurement; 0: without one.

    `kept` (m, 3, ticks) is a ring, written at `now`.
    """
    at = int(BINS * shift + (EARLIEST + 0.5))
    shift = (shift - (at - EARLIEST) / BINS) * bank.tick_s
    entry = int(np.searchsorted(bank.spans, span))
    gains = bank.gains[min(entry, len(bank.spans) - 1), at]
    stay = bank.stay / mean[TOTAL]
    total = x = v = next_x = next_v = 0.0
    for i in range(len(states)):
        c, s, k = bank.moves[i], states[i], gains[i]
        p, speed, z1, z2, z3, offset = s[0], s[1], s[2], s[3], s[4], s[5]
        e = f = 0.0
        if span > 0:
            e = position - p - (k[20] + shift) * speed - k[21] * z1 - k[22] * z2 - k[23] * z3
            if bank.motion:
                f = motion - (k[24] * speed + k[25] * z1 + k[26] * z2 + k[27] * z3 + offset)
                u = 1.0 + (k[16] * e * e + k[17] * e * f + k[18] * f * f)
            else:
                u = 1.0 + k[16] * e * e
            u2 = u * u
            weights[i] = (bank.leave + stay * weights[i]) * k[19] / (u2 * u2 * u)
            s[STATES] = u
            total += weights[i]
            x += weights[i] * (p + (k[0] * e + k[1] * f))
            v += weights[i] * (speed + (k[2] * e + k[3] * f))
        kept[i, 0, now], kept[i, 1, now], kept[i, 2, now] = speed, e, f
        s[0] = p + c[4] * speed + c[5] * z1 + c[6] * z2 + c[7] * z3
        s[1] = c[0] * speed + z1
        s[2] = c[1] * speed + z2
        s[3] = c[2] * speed + z3
        s[4] = c[3] * speed
        if span > 0:
            for j in range(STATES):
                s[j] += k[4 + 2 * j] * e + k[5 + 2 * j] * f
        next_x += weights[i] * s[0]
        next_v += weights[i] * s[1]
    if span == 0:
        total, x, v = mean[TOTAL], mean[TOTAL] * mean[NEXT_X], mean[TOTAL] * mean[NEXT_V]
    mean[X], mean[V], mean[NEXT_X], mean[NEXT_V] = x / total, v / total, next_x / total, next_v / total
    mean[TOTAL] = total
    if span > 0:
        offset = states[np.argmax(weights), 5]
        for i in range(len(states)):
            if states[i, STATES] > LOST:
                _steady(bank, states, i, mean[NEXT_X], mean[NEXT_V], offset)


@njit(cache=True, nogil=True)
def _steady(bank: Bank, states: F, mode: int, position: float, speed: float, offset: float) -> None:
    """Let a mode have a constant speed."""
    z1 = speed - bank.moves[mode, 0] * speed
    z2 = z1 - bank.moves[mode, 1] * speed
    states[mode, 0], states[mode, 1], states[mode, 2], states[mode, 3] = position, speed, z1, z2
    states[mode, 4], states[mode, 5] = z2 - bank.moves[mode, 2] * speed, offset


@njit(cache=True, nogil=True)
def _look_back(bank: Bank, weights: F, total: float, kept: F, now: int) -> float:
    """Return the speed [m/s] of the tick `delay` ticks ago, as it is known at the tick written at `now`."""
    length = kept.shape[2]
    speed = 0.0
    for i in range(len(weights)):
        mean = kept[i, 0, (now + 1) % length]
        for measurement in range(2 if bank.motion else 1):
            part = 0.0
            for j in range(length):
                part += bank.smoothing[i, measurement, j] * kept[i, 1 + measurement, (now + 1 + j) % length]
            mean += part
        speed += weights[i] * mean
    return speed / total


@njit(cache=True, nogil=True)
def _restart(bank: Bank, states: F, weights: F, mean: F, kept: F, position: float, speed: float) -> None:
    next_x = position + bank.tick_s * speed
    for i in range(len(states)):
        _steady(bank, states, i, next_x, speed, 0.0)
        kept[i, 0, 0], kept[i, 1, 0], kept[i, 2, 0] = speed, 0.0, 0.0
    weights[:] = 1.0 / len(states)
    mean[X], mean[V], mean[NEXT_X], mean[NEXT_V], mean[TOTAL] = position, speed, next_x, speed, 1.0


@njit(cache=True, nogil=True)
def _track(
    stamps: I, positions: F, motion: F, bank: Bank, delay: int, measured: bool, max_gap_ns: int, limits: F,
    settling: float, rate: float,
) -> Any:  # fmt: skip
    """Do the work of `track`; `limits` are outlier [m], stroke [m] twice, largest change [m/s] and overdue [s]."""
    n, modes = len(stamps), len(bank.moves)
    outlier, low, high, largest_change, overdue = limits[0], limits[1], limits[2], limits[3], limits[4]
    room = n + 2
    for i in range(1, n):
        step = abs(stamps[i] - stamps[i - 1])
        room += int(min(step, (PATIENCE + 2) * max_gap_ns) * rate * 1e-9) + 2
    ticks, late, times = np.empty((room, 2)), np.empty((room, 2)), np.empty(room, np.int64)  # unused rows cost nothing
    total, status = np.zeros(n, np.int64), np.zeros(n, np.int8)
    ahead, innovations = np.zeros(n), np.full(n, np.nan)
    states, weights, mean = np.zeros((modes, STATES + 1)), np.zeros(modes), np.ones(5)
    kept = np.zeros((modes, 3, delay + 1))
    saved_states, saved_weights, saved_mean, saved_kept = states.copy(), weights.copy(), mean.copy(), kept.copy()
    m = last = rejected = waiting = measured_ticks = 0
    likelihood = 0.0
    sum_x = sum_shift = waiting_motion = 0.0
    tau = settled = doubted = heard = lost_s = 0.0
    stamp = origin = np.int64(0)
    started = False
    for i in range(n):
        position = positions[i]
        total[i] = m
        if not low <= position <= high:
            status[i] = STATUS_BEYOND
            continue
        gap = stamps[i] - stamp
        restart = not started or gap > max_gap_ns or gap < -max_gap_ns
        if not restart and gap <= 0:
            status[i] = STATUS_ORDER
            continue
        unsettled = guessed = False
        lost = 0
        newest = last
        shift = new_tau = old_x = old_v = 0.0
        if not restart:
            interval = gap * 1e-9
            new_tau = (stamps[i] - origin) * (rate * 1e-9)
            newest = int(floor(new_tau + 0.5))
            lost = newest - last - 1
            old_x, old_v = mean[X], mean[V]
            if lost > 0:
                saved_states[:], saved_weights[:], saved_mean[:], saved_kept[:] = states, weights, mean, kept
                for skipped in range(lost):
                    tick = last + 1 + skipped
                    now = tick % (delay + 1)
                    if skipped == 0 and waiting > 0:
                        _update(
                            bank, 1, states, weights, mean, kept, sum_x / waiting, sum_shift / waiting, waiting_motion,
                            now,
                        )  # fmt: skip
                    else:
                        _update(bank, 0, states, weights, mean, kept, 0.0, 0.0, 0.0, now)
                    at = m + skipped
                    late[at, 0], late[at, 1] = mean[X], np.nan
                    if delay > 0 and tick >= delay:
                        late[at - delay, 1] = _look_back(bank, weights, mean[TOTAL], kept, now)
            shift = new_tau - newest if lost >= 0 else new_tau - newest - 1.0
            bend = 0.5 * shift * (mean[NEXT_V] - mean[V])
            expected = mean[NEXT_X] + shift * bank.tick_s * (mean[NEXT_V] + bend)
            innovation = position - expected
            innovations[i] = innovation
            plausible = True
            if interval > overdue or abs(innovation) > outlier:
                if rejected == 0:
                    heard = lost_s = 0.0
                lost_s += max(interval - heard - overdue, 0.0)
                heard = interval
                unsettled, guessed = lost_s > 0.0, lost_s > DOUBT * settling
                if abs(innovation) > outlier:
                    changed = lost_s - 0.5 * settling if lost_s > settling else 0.5 * lost_s * lost_s / settling
                    changed = interval if tau < settled else changed
                    plausible = changed > 0.0 and abs(innovation) <= outlier + largest_change * changed
                    unsettled = guessed = True
            if not plausible:
                if lost > 0:
                    states[:], weights[:], mean[:], kept[:] = saved_states, saved_weights, saved_mean, saved_kept
                    for at in range(max(m - delay, 0), max(m + lost - delay, 0)):
                        late[at, 1] = np.nan
                rejected += 1
                restart = rejected > PATIENCE
                if not restart:
                    status[i] = STATUS_OUTLIER
                    continue
        if restart:
            _restart(bank, states, weights, mean, kept, position, motion[i] if measured else 0.0)
            started, status[i] = True, STATUS_RESTART
            stamp = origin = stamps[i]
            tau, settled, doubted = 0.0, settling * rate, 0.0
            last = rejected = waiting = 0
            sum_x = sum_shift = heard = lost_s = 0.0
            ticks[m, 0], ticks[m, 1], times[m] = position, mean[V], stamp
            late[m, 0], late[m, 1] = position, np.nan
            m += 1
            total[i] = m
            continue
        rejected = 0
        stamp, tau = stamps[i], new_tau
        ahead[i] = tau - newest
        if lost < 0:
            waiting += 1
            sum_x, sum_shift = sum_x + position, sum_shift + shift
            waiting_motion = motion[i]
        else:
            span = lost + 1
            if waiting > 0:
                if lost > 0:
                    span = lost
                else:
                    count = waiting + 1
                    position, shift = (sum_x + position) / count, (sum_shift + shift) / count
                waiting = 0
                sum_x = sum_shift = 0.0
            now = newest % (delay + 1)
            _update(bank, span, states, weights, mean, kept, position, shift, motion[i], now)
            likelihood += log(mean[TOTAL])
            measured_ticks += 1
            for skipped in range(lost):
                share = (skipped + 1) / (lost + 1)
                ticks[m + skipped, 0] = old_x + share * (mean[X] - old_x)
                ticks[m + skipped, 1] = old_v + share * (mean[V] - old_v)
            at = m + lost
            ticks[at, 0], ticks[at, 1] = mean[X], mean[V]
            late[at, 0], late[at, 1] = mean[X], np.nan
            if delay > 0 and newest >= delay:
                late[at - delay, 1] = _look_back(bank, weights, mean[TOTAL], kept, now)
            for tick in range(last + 1, newest + 1):
                times[m] = origin + np.int64(floor(tick * (1e9 / rate) + 0.5))
                m += 1
            last = newest
        total[i] = m
        if unsettled:
            settled = tau + settling * rate
            if guessed:
                doubted = tau + DOUBT * (settling * rate)
        if tau < doubted:
            status[i] = STATUS_UNSETTLED
    if delay == 0:
        late[:m] = ticks[:m]
    likelihood /= max(measured_ticks, 1)
    return ticks[:m], times[:m], total, status, ahead, late[:m], innovations, likelihood
