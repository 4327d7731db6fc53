"""The numerical kernels: plain loops over arrays, compiled by Numba, each with a slow readable twin in the tests.

`powers` (rows, ticks) is the power table; `segments[s] = (start, stop)` are ticks without a gap. Before a segment's
start the inputs equal those of its first tick and the forces are zero, exactly as in
`ces_observer.structures.polynomial`.
"""

from __future__ import annotations

from math import cos, exp, floor, inf, log, pi, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ces_data.arrays import F, I
from ces_observer.adaptive_differentiator import MAX_SQUARE, MEMORY_S, NOISE_SHARE, SHARES
from ces_observer.model import ADAPTIVE, FUSED, KALMAN, MEASURED
from ces_observer.tracker import DOUBT, LARGEST_CHANGE, OVERDUE, PATIENCE, SETTLING

BLOCK = 1024  # ticks per pass, which fit into the first-level cache
Bounds = tuple[float, float]  # lowest and highest force of a free run [N]
STATUS_OK, STATUS_ORDER, STATUS_OUTLIER, STATUS_RESTART, STATUS_UNSETTLED = 0, 1, 2, 3, 4


class TermArrays(NamedTuple):
    """A set of terms: factor f of term t is row `columns[t, f]` of the power table, `lags[t, f]` ticks back.

    `counts[t]` is the number of factors, `outputs[t]` the lag of the past force, 0 if the term has none.
    """

    columns: I
    lags: I
    counts: I
    outputs: I


class ScoredRun(NamedTuple):
    """What the cost of a free run needs besides the terms.

    `weights` (ticks,) is 1 / sum (y - mean y)^2 of the tick's recording where the tick is scored, else 0;
    `recordings[s]` is the index of segment s's recording, ascending.
    """

    powers: F
    segments: I
    recordings: I
    weights: F
    measured: F
    bounds: Bounds


def track(
    stamps: I,
    positions: F,
    rate: float,
    bandwidth: float,
    max_gap_ns: int,
    outlier: float,
    order: int = 3,
    motion: F | None = None,
    differentiator: str = KALMAN,
    noise_m: float = 0.0,
) -> tuple[F, I, I, NDArray[np.int8], F, float]:
    """Twin of `ces_observer.tracker.Tracker` over n finite samples; `motion` (n,) as in its `advance`.

    Returns ticks (m, 2) of position and speed, tick stamps (m,) [ns], for each sample the number of ticks so far,
    its status and its time after the last tick [ticks], and the sum of squared innovations [m2].
    """
    adaptive = differentiator == ADAPTIVE
    shares = np.array(SHARES if adaptive else (1.0,))
    variance = NOISE_SHARE * noise_m * noise_m if adaptive else 1.0
    result: tuple[F, I, I, NDArray[np.int8], F, float] = _track(
        stamps,
        positions,
        np.zeros(len(stamps)) if motion is None else motion,
        rate,
        bandwidth,
        max_gap_ns,
        outlier,
        order,
        shares,
        variance,
        differentiator == FUSED,
        differentiator == MEASURED,
    )
    return result


@njit(cache=True, nogil=True)
def _correct(
    filters: F, scores: F, shares: F, bandwidth: float, order: int, variance: float, interval: float, position: float
) -> tuple[float, float, float]:
    """Correct the filters (f, 3) of position, speed and acceleration; return the same of their weighted mean."""
    damping = 0.5 if order == 3 else sqrt(0.5)
    fade = exp(-interval / MEMORY_S)
    for i in range(len(shares)):
        radius = exp(-damping * 2.0 * pi * (shares[i] * bandwidth) * interval)
        turn = sqrt(1.0 - damping * damping) * 2.0 * pi * (shares[i] * bandwidth)
        pair = 2.0 * radius * cos(turn * interval)
        square = radius * radius
        x, v, a = filters[i, 0], filters[i, 1], filters[i, 2]
        innovation = position - (x + interval * (v + 0.5 * interval * a))
        product = square
        second = 1.0 - pair + square
        if order == 3:
            product = square * square
            third = 0.5 * (1.0 - square) * (1.0 - pair + square)
            second = product + 2.0 - pair - square - third
            filters[i, 2] = a + 2.0 * third * innovation / (interval * interval)
        filters[i, 1] = v + (interval * a + second * innovation / interval)
        filters[i, 0] = position - product * innovation
        surprise = min(innovation * innovation * product / variance, MAX_SQUARE)
        scores[i] = fade * scores[i] - 0.5 * (surprise - log(product))
    if len(shares) == 1:
        return filters[0, 0], filters[0, 1], filters[0, 2]
    x, v, a = _weighted_mean(filters, scores)
    return x, v, a


@njit(cache=True, nogil=True)
def _weighted_mean(filters: F, scores: F) -> tuple[float, float, float]:
    """Return the mean of the filters (f, 3), weighted by exp(scores); loops compile faster than sums of arrays."""
    top = scores[0]
    for i in range(1, len(scores)):
        top = max(top, scores[i])
    x = v = a = total = 0.0
    for i in range(len(scores)):
        weight = exp(scores[i] - top)
        total += weight
        x += weight * filters[i, 0]
        v += weight * filters[i, 1]
        a += weight * filters[i, 2]
    return x / total, v / total, a / total


@njit(cache=True, nogil=True)
def _track(
    stamps: I,
    positions: F,
    motion: F,
    rate: float,
    bandwidth: float,
    max_gap_ns: int,
    outlier: float,
    order: int,
    shares: F,
    variance: float,
    fused: bool,
    measured: bool,
) -> tuple[F, I, I, NDArray[np.int8], F, float]:
    """Do the work of `track`, with a Kalman filter for each of the `shares` of the bandwidth."""
    n = len(stamps)
    room = n + 2
    for i in range(1, n):
        step = abs(stamps[i] - stamps[i - 1])
        room += int(min(step, (PATIENCE + 2) * max_gap_ns) * rate * 1e-9) + 2
    ticks = np.empty((room, 2))
    times = np.empty(room, np.int64)
    total = np.zeros(n, np.int64)
    status = np.zeros(n, np.int8)
    ahead = np.zeros(n)
    largest_change = LARGEST_CHANGE * 2.0 * pi * bandwidth * outlier
    overdue = OVERDUE / rate
    settling = SETTLING / (2.0 * pi * bandwidth)
    m = 0
    last = 0
    rejected = 0
    squares = 0.0
    x = v = a = tau = settled = doubted = innovation = heard = lost = 0.0
    speed = bias = newest_motion = mean = 0.0
    filters, scores = np.zeros((len(shares), 3)), np.zeros(len(shares))
    stamp = origin = np.int64(0)
    for i in range(n):
        status[i] = STATUS_OK
        gap = stamps[i] - stamp
        restart = i == 0 or gap > max_gap_ns or gap < -max_gap_ns
        if not restart and gap <= 0:
            status[i] = STATUS_ORDER
            total[i] = m
            continue
        interval = gap * 1e-9
        doubtful = unsettled = guessed = False
        if not restart:
            if fused:
                mean = 0.5 * (newest_motion + motion[i])
                a = filters[0, 2] = bias + mean
            innovation = positions[i] - (x + interval * (v + 0.5 * interval * a))
            doubtful = interval > overdue or abs(innovation) > outlier
        if doubtful:
            if rejected == 0:
                heard = lost = 0.0
            lost += max(interval - heard - overdue, 0.0)
            heard = interval
            unsettled = lost > 0.0
            guessed = lost > DOUBT * settling
        if doubtful and abs(innovation) > outlier:
            coasted = positions[i] - (x + interval * v)
            coasts = abs(coasted) < abs(innovation) and not fused
            innovation = coasted if coasts else innovation
            changed = lost - 0.5 * settling if lost > settling else 0.5 * lost * lost / settling
            changed = interval if tau < settled else changed
            if changed > 0.0 and abs(innovation) <= outlier + largest_change * changed:
                if coasts:
                    filters[:, 2] = 0.0
                unsettled = guessed = True
            else:
                rejected += 1
                restart = rejected > PATIENCE
                if not restart:
                    status[i] = STATUS_OUTLIER
                    total[i] = m
                    continue
        rejected = 0
        if restart:
            status[i] = STATUS_RESTART
            x, v, a = positions[i], 0.0, 0.0
            filters[:, 0], filters[:, 1], filters[:, 2], scores[:] = x, 0.0, 0.0, 0.0
            speed = motion[i] if measured else 0.0
            newest_motion, bias = motion[i], 0.0
            stamp = origin = stamps[i]
            tau = 0.0
            settled = settling * rate
            doubted = 0.0
            last = 0
            ticks[m, 0] = x
            ticks[m, 1] = speed
            times[m] = stamp
            m += 1
            total[i] = m
            continue
        old_x, old_v, old_tau = x, speed, tau
        squares += innovation * innovation
        x, v, a = _correct(filters, scores, shares, bandwidth, order, variance, interval, positions[i])
        if fused:
            bias = a - mean
            newest_motion = motion[i]
            a = filters[0, 2] = bias + newest_motion
        speed = motion[i] if measured else v
        stamp = stamps[i]
        tau = (stamp - origin) * (rate * 1e-9)
        if unsettled:
            settled = tau + settling * rate
        if guessed:
            doubted = tau + DOUBT * (settling * rate)
        if tau < doubted:
            status[i] = STATUS_UNSETTLED
        newest = floor(tau + 0.5)
        for tick in range(last + 1, newest + 1):
            if tick <= tau:
                share = (tick - old_tau) / (tau - old_tau)
                ticks[m, 0] = old_x + share * (x - old_x)
                ticks[m, 1] = old_v + share * (speed - old_v)
            else:
                lead = (tick - tau) / (tau - old_tau) * interval
                ticks[m, 0] = x + lead * speed
                ticks[m, 1] = speed + lead * a
            times[m] = origin + np.int64(floor(tick * (1e9 / rate) + 0.5))
            m += 1
        last = newest
        ahead[i] = tau - newest
        total[i] = m
    return ticks[:m].copy(), times[:m].copy(), total, status, ahead, squares


@njit(cache=True, nogil=True)
def power_row(values: F, power: float, signed: bool) -> F:
    """Return |s|^power, or sign(s) |s|^power if `signed`, for each value s."""
    row = np.empty(len(values))
    for k in range(len(values)):
        s = abs(values[k])
        if power == 0.0:
            p = 1.0
        elif power == 1.0:
            p = s
        elif power == 2.0:
            p = s * s
        elif power == 0.5:
            p = sqrt(s)
        elif power == 1.5:
            p = s * sqrt(s)
        else:
            p = s**power
        row[k] = -p if signed and np.copysign(1.0, values[k]) < 0.0 else p
    return row


@njit(cache=True, nogil=True)
def _add_product(
    powers: F, terms: TermArrays, term: int, scale: float, start: int, k0: int, k1: int, target: F
) -> None:
    """Add scale times the product of a term's input factors over ticks k0 to k1 to target[: k1 - k0]."""
    columns, lags, count = terms.columns[term], terms.lags[term], terms.counts[term]
    n = k1 - k0
    out = target[:n]
    deepest = 0
    for f in range(count):
        deepest = max(deepest, lags[f])
    if count > 3 or k0 - deepest < start:
        for i in range(n):
            product = scale
            for f in range(count):
                product *= powers[columns[f], max(k0 + i - lags[f], start)]
            out[i] += product
    elif count == 0:
        for i in range(n):
            out[i] += scale
    elif count == 1:
        one = powers[columns[0], k0 - lags[0] : k1 - lags[0]]
        for i in range(n):
            out[i] += scale * one[i]
    elif count == 2:
        one = powers[columns[0], k0 - lags[0] : k1 - lags[0]]
        two = powers[columns[1], k0 - lags[1] : k1 - lags[1]]
        for i in range(n):
            out[i] += scale * one[i] * two[i]
    else:
        one = powers[columns[0], k0 - lags[0] : k1 - lags[0]]
        two = powers[columns[1], k0 - lags[1] : k1 - lags[1]]
        three = powers[columns[2], k0 - lags[2] : k1 - lags[2]]
        for i in range(n):
            out[i] += scale * one[i] * two[i] * three[i]


@njit(cache=True, nogil=True)
def _run_block(
    powers: F, terms: TermArrays, coefficients: F, start: int, k0: int, k1: int, bounds: Bounds, force: F, work: F
) -> int:
    """Free-run ticks k0 to k1 of a segment that starts at `start`; returns the first tick out of bounds, or k1.

    `work` (1 + output lags, BLOCK) receives the inputs' part of the force and the gain of each distinct output lag.
    """
    n = k1 - k0
    inputs = work[0]
    outputs = terms.outputs
    low, high = bounds
    used = np.empty(len(outputs), np.int64)
    n_used = 0
    inputs[:n] = 0.0
    for t in range(len(coefficients)):
        slot = -1
        if outputs[t] > 0:
            slot = 0
            while slot < n_used and used[slot] != outputs[t]:
                slot += 1
            if slot == n_used:
                used[slot] = outputs[t]
                n_used += 1
                work[1 + slot, :n] = 0.0
        _add_product(powers, terms, t, coefficients[t], start, k0, k1, work[1 + slot])
    if n_used == 1 and k0 - used[0] >= start:
        end: int = _recursion_of_one(inputs[:n], work[1, :n], force[k0 - used[0] : k1], used[0], k0, low, high)
        return end
    for i in range(n):
        y = inputs[i]
        k = k0 + i
        for slot in range(n_used):
            back = k - used[slot]
            if back >= start:
                y += work[1 + slot, i] * force[back]
        force[k] = y
        if not low <= y <= high:
            return k
    return k1


@njit(cache=True, nogil=True)
def _recursion_of_one(inputs: F, gain: F, force: F, lag: int, k0: int, low: float, high: float) -> int:
    """Run the recursion with one output lag; `force` begins `lag` ticks before the block."""
    bounded = True
    for i in range(len(inputs)):
        y = inputs[i] + gain[i] * force[i]
        force[i + lag] = y
        bounded &= low <= y <= high
    if bounded:
        return k0 + len(inputs)
    for i in range(len(inputs)):
        if not low <= force[i + lag] <= high:
            break
    return k0 + i


@njit(cache=True, nogil=True)
def free_run(powers: F, segments: I, terms: TermArrays, coefficients: F, bounds: Bounds) -> tuple[F, int]:
    """Simulate every segment from its own past forces.

    Returns force (ticks,) [N], NaN from where it left `bounds` to the end of that segment, and the first such tick,
    or -1.
    """
    force = np.zeros(powers.shape[1])
    work = np.empty((1 + len(coefficients), BLOCK))
    first = -1
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        k0 = start
        while k0 < stop:
            k1 = min(k0 + BLOCK, stop)
            end = _run_block(powers, terms, coefficients, start, k0, k1, bounds, force, work)
            if end < k1:
                force[end:stop] = np.nan
                first = end if first < 0 else first
                break
            k0 = k1
    return force, first


@njit(cache=True, nogil=True)
def free_run_cost(run: ScoredRun, terms: TermArrays, coefficients: F, best: float, work: F, force: F) -> float:
    """Return the mean over recordings of the free-run cost J [%], or infinity as soon as it must exceed `best`."""
    powers, segments, recordings, weights, measured, bounds = run
    n_recordings = recordings[-1] + 1
    done = 0.0
    share = 0.0
    for s in range(len(segments)):
        if s > 0 and recordings[s] != recordings[s - 1]:
            done += sqrt(share)
            share = 0.0
        start, stop = segments[s, 0], segments[s, 1]
        k0 = start
        while k0 < stop:
            k1 = min(k0 + BLOCK, stop)
            end = _run_block(powers, terms, coefficients, start, k0, k1, bounds, force, work)
            if end < k1:
                return inf
            for k in range(k0, k1):
                error = force[k] - measured[k]
                share += weights[k] * error * error
            if 100.0 * (done + sqrt(share)) > best * n_recordings:
                return inf
            k0 = k1
    cost: float = 100.0 * (done + sqrt(share)) / n_recordings
    return cost


@njit(cache=True, nogil=True)
def solve_normal(gram: F, chosen: I, ridge: float) -> tuple[F, bool]:
    """Solve least squares of the last column of `gram` on the `chosen` ones, by a scaled Cholesky factorisation.

    Returns the coefficients and whether the columns were independent (pivots above `ridge` after scaling).
    """
    n = len(chosen)
    y = gram.shape[0] - 1
    scale = np.empty(n)
    for i in range(n):
        d = gram[chosen[i], chosen[i]]
        if d <= 0.0:
            return np.zeros(n), False
        scale[i] = 1.0 / sqrt(d)
    factor = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = gram[chosen[i], chosen[j]] * scale[i] * scale[j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                if total <= ridge:
                    return np.zeros(n), False
                factor[i, i] = sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
    solution = np.empty(n)
    for i in range(n):
        total = gram[chosen[i], y] * scale[i]
        for k in range(i):
            total -= factor[i, k] * solution[k]
        solution[i] = total / factor[i, i]
    for i in range(n - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, n):
            total -= factor[k, i] * solution[k]
        solution[i] = total / factor[i, i]
    for i in range(n):
        solution[i] *= scale[i]
    return solution, True


@njit(cache=True, nogil=True)
def regressor_columns(powers: F, measured: F, segments: I, terms: TermArrays, k0: int, k1: int, segment: int) -> F:
    """Return the regressors (terms, k1 - k0) over ticks of one segment, with the past forces of `measured`."""
    n = k1 - k0
    start = segments[segment, 0]
    outputs = terms.outputs
    out = np.zeros((len(outputs), n))
    for t in range(len(outputs)):
        _add_product(powers, terms, t, 1.0, start, k0, k1, out[t])
        if outputs[t] > 0:
            for i in range(n):
                back = k0 + i - outputs[t]
                out[t, i] *= measured[back] if back >= start else 0.0
    return out


@njit(cache=True, nogil=True)
def probed_gain(probes: F, outputs: I, coefficients: F) -> float:
    """Return the largest sum over output lags of |sum of coefficient * probe| over the probed inputs.

    `probes` (terms, points) holds the product of each term's input factors at each point, for terms with a past force.
    """
    largest = 0.0
    for point in range(probes.shape[1]):
        total = 0.0
        for t in range(len(outputs)):
            if outputs[t] == 0:
                continue
            first = True
            for r in range(t):
                first &= outputs[r] != outputs[t]
            if first:
                share = 0.0
                for r in range(t, len(outputs)):
                    if outputs[r] == outputs[t]:
                        share += coefficients[r] * probes[r, point]
                total += abs(share)
        largest = max(largest, total)
    return largest


@njit(cache=True, nogil=True)
def first_better(
    gram: F,
    chosen: I,
    trial: I,
    run: ScoredRun,
    terms: TermArrays,
    best: float,
    ridge: float,
    probes: F,
    max_gain: float,
    drop: bool,
) -> tuple[int, float, F]:
    """Try each candidate of `trial` added to (or, with `drop`, each place of `trial` removed from) `chosen`.

    Fits by least squares on `gram`, skips models with a probed gain of `max_gain` or more, evaluates the free run, and
    stops at the first cost below `best`. Returns the place in `trial` (-1 if none was better), the cost and the
    coefficients.
    """
    n = len(chosen) - 1 if drop else len(chosen) + 1
    subset = np.empty(n, np.int64)
    work = np.empty((1 + n, BLOCK))
    force = np.empty(run.powers.shape[1])
    for place in range(len(trial)):
        if drop:
            k = 0
            for i in range(len(chosen)):
                if i != trial[place]:
                    subset[k] = chosen[i]
                    k += 1
        else:
            subset[: n - 1] = chosen
            subset[n - 1] = trial[place]
        coefficients, independent = solve_normal(gram, subset, ridge)
        if not independent or probed_gain(probes[subset], terms.outputs[subset], coefficients) >= max_gain:
            continue
        arrays = TermArrays(terms.columns[subset], terms.lags[subset], terms.counts[subset], terms.outputs[subset])
        cost = free_run_cost(run, arrays, coefficients, best, work, force)
        if cost < best:
            return place, cost, coefficients
    return -1, best, np.empty(0)
