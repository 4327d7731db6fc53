"""Percentiles of the histogram against those of all values."""

from __future__ import annotations

from math import ceil

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ces_observer.health.health import CLASSES, MAX_NS, Latencies, LatencyFigures


@given(st.lists(st.integers(0, 10**11), min_size=1, max_size=500))
def test_percentiles_are_within_the_resolution(values: list[int]) -> None:
    latencies = Latencies()
    for value in values:
        latencies.take(value)
    figures = latencies.roll()
    assert (figures.max_ns, figures.samples) == (max(values), len(values))
    for percent, found in ((50, figures.p50_ns), (99, figures.p99_ns)):
        exact = int(np.percentile(values, percent, method="inverted_cdf"))
        assert exact == sorted(values)[ceil(len(values) * percent / 100) - 1]
        assert abs(found - exact) <= exact / 128


def test_a_window_forgets_the_one_before() -> None:
    latencies = Latencies()
    latencies.take(10**9)
    latencies.roll()
    assert latencies.roll() == LatencyFigures(0, 0, 0, 0)
    latencies.take(100)
    assert latencies.roll() == LatencyFigures(100, 100, 100, 1)


def test_the_ends_of_the_range() -> None:
    latencies = Latencies()
    for ns in (-5, 0, MAX_NS, MAX_NS + 1, 10**15):
        latencies.take(ns)
    figures = latencies.roll()
    assert (figures.max_ns, figures.samples) == (10**15, 5)
    assert figures.p50_ns > 0.99 * MAX_NS
    assert len(latencies._counts) == CLASSES
