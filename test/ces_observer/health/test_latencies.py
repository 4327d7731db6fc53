"""Percentiles of the latencies of a window."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ces_observer.health.health import MAX_LATENCIES, Latencies, LatencyFigures


@given(st.lists(st.integers(-5, 10**15), min_size=1, max_size=300))
def test_percentiles_are_those_of_all_and_a_window_forgets_the_one_before(values: list[int]) -> None:
    latencies = Latencies()
    for value in values:
        latencies.take(value)
    p50, p99 = (max(0, int(np.percentile(values, percent, method="inverted_cdf"))) for percent in (50, 99))
    assert latencies.roll() == LatencyFigures(p50, p99, max(0, *values), len(values))
    assert latencies.roll() == LatencyFigures(0, 0, 0, 0)


def test_memory_does_not_grow() -> None:
    latencies = Latencies()
    for value in range(3 * MAX_LATENCIES):
        latencies.take(value)
    assert latencies.roll().samples == MAX_LATENCIES
