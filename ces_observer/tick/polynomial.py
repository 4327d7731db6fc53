"""The polynomial NARX: y(k) = sum_j a_j(u) y(k - j) + b(u), a_j and b sums of products of powers of past inputs u.

The values of a tick stand in s: 1, position, speed, current, constructed inputs and their states; then powers of these,
values some ticks ago, and products of two values. A term is a coefficient times two values, with 1 for a missing one; a
term of more factors uses products. The terms of b come first, then those of each a_j, as in the kernels of the desk.
`ces_observer.structures.polynomial` holds the record, proves that it is stable, and lays out the tables.
"""

from math import copysign, pow, sqrt

from ces_observer.tick.arrays import Floats, Ints
from ces_observer.tick.constructed import CONSTRUCTED_STATES, MAX_SIGNAL, check_constructed, constructed_update
from ces_observer.tick.model import (
    CLAMPED, CURRENT_HIGH, CURRENT_LOW, HELD, K_STRUCTURE, N_STRUCTURE, P_STRUCTURE, POSITION_HIGH, POSITION_LOW,
    S_STRUCTURE, SPEED_HIGH, SPEED_LOW, STARTED, are_between, are_indices, clamp, hold_force, is_clamped,
    lies_within,
)  # fmt: skip

# n: where tables begin in n, and how many rows they have: constructed inputs; powers (source in s, whether signed,
# exponents in p); lags (source in s; begin and end in s of a ring of as many ticks as the lag); output lags (number
# of terms; begin and end of the ring of past forces); two factors of each term, as places in s. Its coefficient is in
# p. Products that later rows use come first, then the terms of b, then those of each a_j
(
    CONSTRUCTED_TABLE, CONSTRUCTED_COUNT, POWER_TABLE, POWER_COUNT, POWER_EXPONENTS, LAG_TABLE, LAG_COUNT,
    OUTPUT_LAG_TABLE, OUTPUT_LAG_COUNT, TERM_FACTORS, TERM_COEFFICIENTS, PRODUCT_COUNT, INPUT_TERM_COUNT, N_POLYNOMIAL,
) = range(N_STRUCTURE, N_STRUCTURE + 14)  # fmt: skip

# s
UNITY, POSITION_VALUE, SPEED_VALUE, CURRENT_VALUE, S_POLYNOMIAL = range(S_STRUCTURE, S_STRUCTURE + 5)

# k, from K_STRUCTURE on: the place in s of the oldest value of each ring, those of inputs first

MAX_EXPONENT = 8.0


def power_of(value: float, power: float, is_signed: bool) -> float:
    """Return |s|^power, or sign(s) |s|^power if `is_signed`."""
    size = abs(value)
    if power == 1.0:
        result = size
    elif power == 2.0:
        result = size * size
    elif power == 0.5:
        result = sqrt(size)
    elif power == 1.5:
        result = size * sqrt(size)
    elif power == 0.0:
        result = 1.0
    else:
        result = pow(size, power)
    return copysign(result, value) if is_signed else result


def polynomial_reset(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Forget the past: earlier forces are zero, earlier inputs equal the first ones to come."""
    k[CLAMPED] = 0
    k[HELD] = 0
    k[STARTED] = 0
    s[UNITY] = 1.0


def start_rings(n: Ints, s: Floats, k: Ints) -> None:
    """Fill the rings of inputs with their first values, those of forces with zeros."""
    row = n[LAG_TABLE]
    outputs = K_STRUCTURE + n[LAG_COUNT]
    for ring in range(K_STRUCTURE, outputs):
        fill_ring(s, n[row + 1], n[row + 2], s[n[row]])
        k[ring] = n[row + 1]
        row += 3
    row = n[OUTPUT_LAG_TABLE]
    for ring in range(outputs, outputs + n[OUTPUT_LAG_COUNT]):
        fill_ring(s, n[row + 1], n[row + 2], 0.0)
        k[ring] = n[row + 1]
        row += 3


def fill_ring(s: Floats, begin: int, end: int, value: float) -> None:
    """Set s[begin] to s[end - 1] to a value."""
    for place in range(begin, end):
        s[place] = value


def update_values(p: Floats, n: Ints, s: Floats, k: Ints) -> None:
    """Compute all values from the tick's inputs."""
    started = k[STARTED] != 0
    constructed = n[CONSTRUCTED_COUNT]
    if constructed > 0:
        constructed_update(p, n, s, n[CONSTRUCTED_TABLE], constructed, POSITION_VALUE, started)
    value = S_POLYNOMIAL + constructed * (1 + CONSTRUCTED_STATES)
    row = n[POWER_TABLE]
    begin = n[POWER_EXPONENTS]
    for exponent in range(begin, begin + n[POWER_COUNT]):
        s[value] = power_of(s[n[row]], p[exponent], n[row + 1] != 0)
        value += 1
        row += 2
    if not started:
        start_rings(n, s, k)
        k[STARTED] = 1
    row = n[LAG_TABLE]
    for ring in range(K_STRUCTURE, K_STRUCTURE + n[LAG_COUNT]):
        oldest = k[ring]
        s[value] = s[oldest]
        s[oldest] = s[n[row]]
        oldest += 1
        k[ring] = oldest if oldest < n[row + 2] else n[row + 1]
        value += 1
        row += 3
    factor = n[TERM_FACTORS]
    begin = n[TERM_COEFFICIENTS]
    for product in range(begin, begin + n[PRODUCT_COUNT]):
        s[value] = p[product] * s[n[factor]] * s[n[factor + 1]]
        value += 1
        factor += 2


def sum_terms(p: Floats, n: Ints, s: Floats, k: Ints) -> float:
    """Return b(u) + sum_j a_j(u) y(k - j) [N]."""
    factor = n[TERM_FACTORS] + 2 * n[PRODUCT_COUNT]
    begin = n[TERM_COEFFICIENTS] + n[PRODUCT_COUNT]
    end = begin + n[INPUT_TERM_COUNT]
    force = 0.0
    for term in range(begin, end):
        force += p[term] * s[n[factor]] * s[n[factor + 1]]
        factor += 2
    row = n[OUTPUT_LAG_TABLE]
    outputs = K_STRUCTURE + n[LAG_COUNT]
    for ring in range(outputs, outputs + n[OUTPUT_LAG_COUNT]):
        begin = end
        end += n[row]
        gain = 0.0
        for term in range(begin, end):
            gain += p[term] * s[n[factor]] * s[n[factor + 1]]
            factor += 2
        force += gain * s[k[ring]]
        row += 3
    return force


def polynomial_tick(p: Floats, n: Ints, s: Floats, k: Ints, position: float, speed: float, current: float) -> float:
    """Return the force [N] at inputs [m, m/s, A], held in its range; infinite if it is not finite."""
    if is_clamped(p, position, speed, current):
        k[CLAMPED] = 1
        s[POSITION_VALUE] = clamp(position, p[POSITION_LOW], p[POSITION_HIGH])
        s[SPEED_VALUE] = clamp(speed, p[SPEED_LOW], p[SPEED_HIGH])
        s[CURRENT_VALUE] = clamp(current, p[CURRENT_LOW], p[CURRENT_HIGH])
    else:
        k[CLAMPED] = 0
        s[POSITION_VALUE] = position
        s[SPEED_VALUE] = speed
        s[CURRENT_VALUE] = current
    update_values(p, n, s, k)
    force = hold_force(p, k, sum_terms(p, n, s, k))
    row = n[OUTPUT_LAG_TABLE]
    outputs = K_STRUCTURE + n[LAG_COUNT]
    for ring in range(outputs, outputs + n[OUTPUT_LAG_COUNT]):
        oldest = k[ring]
        s[oldest] = force
        oldest += 1
        k[ring] = oldest if oldest < n[row + 2] else n[row + 1]
        row += 3
    return force


def check_powers(p: Floats, n: Ints, numbers: int, counts: int, signals_end: int) -> bool:
    """Return whether all powers are of signals, which end at s[signals_end], and cannot overflow."""
    rows = n[POWER_COUNT]
    exponents = n[POWER_EXPONENTS]
    fits = lies_within(n[POWER_TABLE], 2 * rows, 0, counts) and lies_within(exponents, rows, 0, numbers)
    fits = fits and are_indices(n, n[POWER_TABLE], rows, 2, UNITY, signals_end)
    fits = fits and are_between(p, exponents, rows, 1, 0.0, MAX_EXPONENT)
    return fits and are_between(p, POSITION_LOW, CURRENT_HIGH + 1 - POSITION_LOW, 1, -MAX_SIGNAL, MAX_SIGNAL)


def rings_end(n: Ints, counts: int, states: int, table: int, begin: int) -> int:
    """Return where the rings of a table end in s, one behind the other from s[begin] on; -1 if they do not fit."""
    if not lies_within(n[table], 3 * n[table + 1], 0, counts):
        return -1
    end = begin
    for row in range(n[table + 1]):
        place = n[table] + 3 * row
        if n[place + 1] != end or not end < n[place + 2] <= states:
            return -1
        end = n[place + 2]
    return end


def check_lags(n: Ints, counts: int, states: int, flags: int, powers_end: int) -> bool:
    """Return whether the rings fit into s behind all values, and keep values that end at s[powers_end]."""
    lags = n[LAG_COUNT]
    if not (0 <= lags <= flags - K_STRUCTURE and 0 <= n[OUTPUT_LAG_COUNT] <= flags - K_STRUCTURE - lags):
        return False
    end = rings_end(n, counts, states, LAG_TABLE, powers_end + lags + n[PRODUCT_COUNT])
    fits = 0 <= end <= states and rings_end(n, counts, states, OUTPUT_LAG_TABLE, end) >= 0
    return fits and are_indices(n, n[LAG_TABLE], lags, 3, UNITY, powers_end)


def check_terms(n: Ints, numbers: int, counts: int, products: int) -> bool:
    """Return whether all factors are values computed before; those of the products begin at s[products]."""
    count = n[PRODUCT_COUNT]
    terms = count + n[INPUT_TERM_COUNT]
    if not are_indices(n, n[OUTPUT_LAG_TABLE], n[OUTPUT_LAG_COUNT], 3, 0, counts):
        return False
    for i in range(n[OUTPUT_LAG_COUNT]):
        terms += n[n[OUTPUT_LAG_TABLE] + 3 * i]
    factors = n[TERM_FACTORS]
    fits = lies_within(factors, 2 * terms, 0, counts) and lies_within(n[TERM_COEFFICIENTS], terms, 0, numbers)
    if not (fits and are_indices(n, factors + 2 * count, 2 * (terms - count), 1, UNITY, products + count)):
        return False
    for i in range(count):
        if not are_indices(n, factors + 2 * i, 2, 1, UNITY, products + i):
            return False
    return True


def check_polynomial(p: Floats, n: Ints, numbers: int, counts: int, states: int, flags: int) -> bool:
    """Return whether the tick stays within arrays of these sizes, and no operation on the numbers of p can fail."""
    if counts < N_POLYNOMIAL or numbers < P_STRUCTURE:
        return False
    rows = n[CONSTRUCTED_COUNT]
    fits = 0 <= n[PRODUCT_COUNT] <= counts and 0 <= n[INPUT_TERM_COUNT] <= counts
    if not (fits and check_constructed(p, n, numbers, counts, states, n[CONSTRUCTED_TABLE], rows, POSITION_VALUE)):
        return False
    powers_end = S_POLYNOMIAL + rows * (1 + CONSTRUCTED_STATES) + n[POWER_COUNT]
    return (
        check_powers(p, n, numbers, counts, S_POLYNOMIAL + rows)
        and check_lags(n, counts, states, flags, powers_end)
        and check_terms(n, numbers, counts, powers_end + n[LAG_COUNT])
    )
