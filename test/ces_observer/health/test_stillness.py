from __future__ import annotations

from math import nan

import pytest

from ces_observer.health.episodes import Stillness

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


def test_nan_is_no_rest() -> None:
    stillness = Stillness(1.0)
    rest(stillness, 0, 3000, nan)
    assert stillness.count == 0


def test_stamps_set_back_begin_anew() -> None:
    stillness = Stillness(1.0)
    rest(stillness, 10_000, 900)
    rest(stillness, 0, 900)
    assert stillness.count == 0


def test_zero_stands_for_never() -> None:
    stillness = Stillness(0.0)
    rest(stillness, 0, 5000)
    assert (stillness.count, stillness.resting) == (0, False)
