"""What the log says of reasons that last, flicker or flood."""

from __future__ import annotations

from math import nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ces_observer.health.diagnostics import MAX_LATENCIES, Latencies, LatencyFigures
from ces_observer.health.episodes import ReasonLog, Stillness
from ces_observer.reasons import OK, OUTLIER


def test_a_state_is_one_line_at_its_begin_and_one_at_its_end() -> None:
    log = ReasonLog()
    lines = [
        log.find_line(0.1 * k, OUTLIER if 50 <= k < 150 else OK, "M", (k >= 50) + (k >= 150), 0) for k in range(300)
    ]
    assert [k for k, line in enumerate(lines) if line] == [0, 50, 150]


def test_the_end_says_how_many_samples_were_withheld() -> None:
    log = ReasonLog()
    log.find_line(0.0, OUTLIER, "withholding", 1, 1)
    assert log.find_line(10.0, OK, "estimating", 2, 501) == "estimating; 500 samples withheld"


def test_a_reason_that_flickers_is_one_line_at_its_begin_and_one_when_it_is_quiet() -> None:
    log, lines = ReasonLog(), {}
    for k in range(1000):  # two hundred seconds; in 75 of them two changes between two reports
        flickers = 100 <= k < 700
        reason, changes = (OUTLIER if flickers and k % 2 else OK), 2 * min(max(0, k - 100), 600)
        if line := log.find_line(0.125 * k, reason, reason, changes, 3 * changes):
            lines[k] = line
    assert list(lines) == [0, 101, 708]
    assert lines[708] == "ok; 1198 changes since the last line; 3594 samples withheld"


MS = 1_000_000


def rest(stillness: Stillness, start_ms: int, length_ms: int, position_m: float = 0.01) -> None:
    for k in range(start_ms, start_ms + length_ms + 1):
        stillness.take(k * MS, position_m)


def test_a_rest_counts_once_it_is_long_enough() -> None:
    stillness = Stillness(1.0)
    rest(stillness, 0, 999)
    assert (stillness.count, stillness.resting) == (0, False)
    rest(stillness, 1000, 500)
    assert (stillness.count, stillness.resting) == (1, True)
    assert stillness.last_s == pytest.approx(1.5)


@pytest.mark.parametrize("other", [0.0100001, nan])
def test_another_number_ends_it(other: float) -> None:
    stillness = Stillness(1.0)
    rest(stillness, 0, 1200)
    stillness.take(1201 * MS, other)
    assert (stillness.count, stillness.resting) == (1, False)
    assert stillness.last_s == pytest.approx(1.2)
    rest(stillness, 1202, 1000)
    assert (stillness.count, stillness.resting) == (2, True)


@pytest.mark.parametrize(
    ("warn_s", "rests"),
    [(1.0, [(0, 3000, nan)]), (1.0, [(10_000, 900, 0.01), (0, 900, 0.01)]), (0.0, [(0, 5000, 0.01)])],
    ids=["not a number", "stamps set back", "never"],
)
def test_what_is_no_rest(warn_s, rests) -> None:
    stillness = Stillness(warn_s)
    for start_ms, length_ms, position_m in rests:
        rest(stillness, start_ms, length_ms, position_m)
    assert (stillness.count, stillness.resting) == (0, False)


# -------------------------------------------------------------------------- Percentiles of the latencies of a window.


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
