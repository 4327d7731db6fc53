"""A paused source, a loss on the way and a full queue are distinguished where the middleware shows them."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ces_observer.health.arrivals import MAX_SWITCHES
from ces_observer.health.streams import UNKNOWN, Arrivals, Losses

MS = 1_000_000
SECOND = 1000 * MS
HOUR, YEAR = 3600 * SECOND, 365 * 86_400 * SECOND
START = 1_700_000_000 * SECOND
BEFORE, AFTER = range(200), range(300, 500)  # samples of a millisecond; a hundred are missing between them


def run(losses: Losses, *, numbers: tuple[range, range] | None, wait_ms: int = 0) -> dict[str, str]:
    """Return the values after a gap; the messages after it are read `wait_ms` late, in a burst."""
    arrivals = Arrivals(losses=losses)
    for part, ticks in enumerate((BEFORE, AFTER)):
        for k, tick in enumerate(ticks):
            losses.take_number(None if numbers is None else numbers[part][k])
            late_ms = max(0, wait_ms - k) if part else 0
            arrivals.take(START + tick * MS, START + (tick + late_ms) * MS)
    figures = arrivals.roll(1.0)
    return {**dict(figures.values("position")), "sentence": figures.describe_missing()}


def results(values: dict[str, str]) -> tuple[str, ...]:
    keys = ("dropped", "dropped, in this node's queue", "dropped, lost on the way", "dropped, not sent")
    return tuple(values[f"position: {key}"] for key in keys)


def test_numbers_without_a_gap_show_that_the_source_paused() -> None:
    values = run(Losses(1000), numbers=(range(200), range(200, 400)))
    assert results(values) == ("100", "0", "0", "100")
    assert values["sentence"] == "missing: the source paused"


def test_numbers_with_a_gap_show_a_loss() -> None:
    values = run(Losses(1000), numbers=(range(200), range(280, 480)))
    assert results(values) == ("100", "0", "80", "20")
    assert values["sentence"] == "missing, 80 of them lost on the way"


def test_without_numbers_the_cause_is_unknown() -> None:
    values = run(Losses(1000), numbers=None)
    assert results(values) == ("100", "0", UNKNOWN, UNKNOWN)
    assert values["sentence"] == "missing: lost on the way, or the source paused"


def test_a_full_queue_is_known_without_numbers() -> None:
    values = run(Losses(150), numbers=None, wait_ms=150)
    assert results(values) == ("100", "100", UNKNOWN, UNKNOWN)
    assert values["sentence"] == "missing, 100 of them dropped by this node's queue: set input_depth higher"


def test_a_burst_shorter_than_the_queue_is_no_overflow() -> None:
    assert results(run(Losses(150), numbers=None, wait_ms=100))[1] == "0"


def test_what_the_queue_dropped_was_not_lost_on_the_way() -> None:
    values = run(Losses(150), numbers=(range(200), range(300, 500)), wait_ms=150)
    assert results(values) == ("100", "100", "0", "0")


def test_an_overflow_that_takes_seconds_is_no_interruption() -> None:
    losses = Losses(1500)
    arrivals = Arrivals(losses=losses)
    for tick in range(200):
        arrivals.take(START + tick * MS, START + tick * MS)
    for tick in range(2700, 4200):
        arrivals.take(START + tick * MS, START + 4200 * MS)
    figures = arrivals.roll(1.0)
    assert (figures.total_dropped, figures.total_interruptions) == (2500, 0)
    assert figures.total_overflowed == pytest.approx(2500)


def test_a_queue_that_overflows_while_it_is_read_is_known_on_clocks_that_differ() -> None:
    arrivals, ahead = Arrivals(losses=Losses(100)), HOUR
    for tick in range(1000):
        arrivals.take(START + tick * MS + ahead, START + tick * MS)
    arrivals.roll(1.0)
    for tick in (1000, *range(1400, 1500)):  # read one after the other, after a stall of half a second
        arrivals.take(START + tick * MS + ahead, START + 1500 * MS)
    for tick in range(1500, 1600):
        arrivals.take(START + tick * MS + ahead, START + tick * MS)
    figures = arrivals.roll(1.0)
    assert (figures.dropped, figures.overflowed) == (399, 399)


def test_numbers_of_several_publishers_cannot_be_used() -> None:
    losses = Losses(1000)
    usable = [losses.take_number(k // 2 + 10**6 * (k % 2)) for k in range(4 * MAX_SWITCHES)]
    assert usable[0]
    assert not usable[-1]
    assert losses.lost is None


def test_a_publisher_that_is_started_again_loses_nothing() -> None:
    losses = Losses(1000)
    assert all(losses.take_number(number) for number in [*range(500), *range(500)])
    assert losses.lost == 0


FORGED = (50 * YEAR, -50 * YEAR, -(2**61), HOUR, -HOUR, 30 * SECOND, -30 * SECOND, 900 * MS, -900 * MS)


@pytest.mark.parametrize("offset_ns", FORGED)
def test_a_forged_stamp_is_one_interruption_and_the_counts_go_on(offset_ns: int) -> None:
    """Its sample is missing, and no other; nothing is said of the queue."""
    arrivals = Arrivals(losses=Losses(1000))
    for tick in range(6000):
        forged = tick in (2500, 3100)
        arrivals.take(START + tick * MS + (offset_ns if forged else 0), START + tick * MS)
        if tick % 1000 == 999:
            figures = arrivals.roll(1.0)
            assert (figures.dropped, figures.overflowed) == (int(2000 < tick < 4000), 0)
            assert abs(figures.mean_age_s) < 1e-6
    assert (figures.total_dropped, figures.total_interruptions) == (2, 2)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32))
def test_dropped_never_runs_back_nor_exceeds_what_fits(seed: int) -> None:
    """Samples are lost, late and forged at random."""
    chance = random.Random(seed)
    arrivals, total = Arrivals(losses=Losses(50)), 0
    for tick in range(1000):
        offset_ns = chance.choice(FORGED) if chance.random() < 0.03 else -chance.choice((0, 0, 0, 3)) * MS
        if chance.random() < 0.95:
            arrivals.take(START + tick * MS + offset_ns, START + tick * MS)
        if tick % 100 == 99:
            figures = arrivals.roll(0.1)
            assert figures.total_dropped is not None
            assert total <= figures.total_dropped <= total + 100 and not figures.total_overflowed
            total = figures.total_dropped


def test_after_the_nodes_clock_was_set_a_gap_is_no_overflow() -> None:
    arrivals = Arrivals(losses=Losses(1000))
    for tick in range(4000):
        if tick == 1500:
            arrivals.restart_ages()
        if not 1700 <= tick < 1800 and not 2700 <= tick < 2800:
            arrivals.take(START + tick * MS, START + tick * MS + (5 * SECOND if tick >= 1500 else 0))
        if tick % 1000 == 999:
            figures = arrivals.roll(1.0)
    assert (figures.total_dropped, figures.total_overflowed, figures.mean_age_s) == (200, 0, 5.0)
