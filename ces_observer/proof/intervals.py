"""Interval arithmetic with outward rounding (Moore, Kearfott & Cloud, Introduction to Interval Analysis, 2009)."""

from __future__ import annotations

from math import inf, nextafter

Interval = tuple[float, float]


def up(value: float) -> float:
    """Return the next larger float: rounding outward."""
    return nextafter(value, inf)


def down(value: float) -> float:
    """Return the next smaller float: rounding outward."""
    return nextafter(value, -inf)


def product(one: Interval, two: Interval) -> Interval:
    """Return an interval that holds every product of a number of `one` and a number of `two`."""
    a, b, c, d = one[0] * two[0], one[0] * two[1], one[1] * two[0], one[1] * two[1]
    return down(min(a, b, c, d)), up(max(a, b, c, d))


def add(one: Interval, two: Interval) -> Interval:
    """Return an interval that holds every sum of a number of `one` and a number of `two`."""
    return down(one[0] + two[0]), up(one[1] + two[1])


def largest(one: Interval) -> float:
    """Return the largest magnitude in an interval."""
    return max(abs(one[0]), abs(one[1]))
