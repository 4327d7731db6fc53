"""Figures of an input topic against what was really sent."""

from __future__ import annotations

import random
from collections.abc import Sequence
from itertools import groupby, pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ces_observer.health.arrivals import LEARN, MAX_SWITCHES
from ces_observer.health.diagnostics import Remarks
from ces_observer.health.streams import Arrivals, Losses, StreamFigures

MS = 1_000_000
SECOND = 1000 * MS
START = 1_700_000_000 * SECOND
DELAY = 300_000  # [ns] from stamp to arrival


def regular(arrivals: Arrivals, first: int, last: int, period_ns: int = MS) -> StreamFigures:
    """Send messages [first, last) of a steady topic and close the window."""
    for k in range(first, last):
        arrivals.take(START + k * period_ns, START + k * period_ns + DELAY)
    return arrivals.roll((last - first) * period_ns * 1e-9)


def test_a_steady_topic() -> None:
    figures = regular(Arrivals(), 0, 1000)
    assert (figures.samples, figures.rate_Hz) == (1000, 1000.0)
    assert (figures.dropped, figures.total_out_of_order, figures.total_duplicates) == (0, 0, 0)
    assert figures.period_s == pytest.approx(1e-3)
    assert [figures.mean_age_s, figures.max_age_s] == pytest.approx([3e-4] * 2)
    assert figures.jitter_s == 0.0
    assert figures.total_interruptions == 0


def test_an_empty_window() -> None:
    arrivals = Arrivals()
    regular(arrivals, 0, 1000)
    figures = arrivals.roll(1.0)
    assert (figures.samples, figures.rate_Hz, figures.mean_age_s) == (0, 0.0, 0.0)
    assert figures.total_samples == 1000


def test_jitter_and_age_are_those_of_the_stamps() -> None:
    chance = np.random.default_rng(1)
    stamps = START + np.arange(1001) * MS + chance.integers(-100_000, 100_000, 1001)
    ages = chance.integers(0, MS, 1001)
    arrivals = Arrivals()
    for stamp, age in zip(stamps[: LEARN + 1].tolist(), ages[: LEARN + 1].tolist(), strict=True):
        arrivals.take(stamp, stamp + age)
    arrivals.roll(0.01)
    for stamp, age in zip(stamps[LEARN + 1 :].tolist(), ages[LEARN + 1 :].tolist(), strict=True):
        arrivals.take(stamp, stamp + age)
    figures = arrivals.roll(1.0)
    intervals = np.diff(stamps[LEARN:])
    assert figures.jitter_s == pytest.approx(intervals.std() * 1e-9, rel=1e-6)
    assert figures.period_s == pytest.approx(intervals.mean() * 1e-9, rel=1e-6)
    assert figures.mean_age_s == pytest.approx(ages[LEARN + 1 :].mean() * 1e-9)
    assert figures.max_age_s == pytest.approx(ages[LEARN + 1 :].max() * 1e-9)


def longest_gap_run(kept: Sequence[int]) -> int:
    runs = (len(list(run)) for gap, run in groupby(b - a > 1 for a, b in pairwise(kept)) if gap)
    return max(runs, default=0)


@settings(deadline=None)
@given(
    loss=st.floats(0.0, 0.35),
    jitter=st.floats(0.0, 0.2),
    period_ns=st.sampled_from([100_000, MS, 5 * MS, 33_333_333]),
    seed=st.integers(0, 2**32),
)
def test_random_losses_are_counted(loss: float, jitter: float, period_ns: int, seed: int) -> None:
    """The estimate is within 2 % of the messages sent, and exact without jitter once the period is known."""
    chance = random.Random(seed)
    arrivals = Arrivals()
    for k in range(LEARN + 1):
        arrivals.take(START + k * period_ns, START + k * period_ns)
    sent = range(LEARN + 1, 1200)
    kept = [k for k in sent if chance.random() >= loss] + [1200, 1201]  # a gap is counted when a usual interval follows
    assume(longest_gap_run(kept) < LEARN)  # so many unusual intervals in a row are a new period, by design
    for k in kept:
        stamp = START + k * period_ns + round(chance.uniform(-jitter, jitter) * period_ns)
        arrivals.take(stamp, stamp)
    lost = len(sent) + 2 - len(kept)
    total = arrivals.roll(1.0).total_dropped
    assert total is not None
    assert abs(total - lost) <= (0.02 * len(sent) if jitter else 0)


@settings(deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 15))
def test_shuffled_messages_are_out_of_order_and_not_dropped(seed: int, apart: int) -> None:
    chance = random.Random(seed)
    arrivals = Arrivals()
    regular(arrivals, 0, 100)
    late = 0
    for begin in range(100, 1000, apart):
        block = list(range(begin, min(begin + apart, 1000)))
        chance.shuffle(block)
        for k in block:
            arrivals.take(START + k * MS, START + begin * MS)
        late += sum(k < max(block[: i + 1]) for i, k in enumerate(block))
    figures = arrivals.roll(0.9)
    assert (figures.total_out_of_order, figures.total_duplicates) == (late, 0)
    # Up to the newest stamp of a block's first message nothing can be counted; all later ones make up for the gaps.
    assert figures.total_dropped == 0


def test_duplicates_are_counted() -> None:
    arrivals = Arrivals()
    regular(arrivals, 0, 100)
    for k in range(100, 200):
        for _ in range(3):
            arrivals.take(START + k * MS, START + k * MS)
    figures = arrivals.roll(0.1)
    assert (figures.total_duplicates, figures.total_out_of_order, figures.dropped) == (200, 0, 0)


@pytest.mark.parametrize("factor", [0.1, 0.8, 1.3, 10.0])
def test_the_period_follows_another_rate_and_nothing_was_dropped(factor: float) -> None:
    arrivals = Arrivals()
    regular(arrivals, 0, 1000)
    begin, period = START + 1000 * MS, round(MS * factor)
    for k in range(round(2000 / factor)):
        arrivals.take(begin + k * period, begin + k * period)
        if k == round(1000 / factor):
            arrivals.roll(1.0)
    figures = arrivals.roll(1.0)
    assert figures.period_s == pytest.approx(factor * 1e-3, rel=1e-3)
    assert figures.total_dropped == 0


def test_losses_while_the_period_is_learnt_do_not_spoil_it() -> None:
    arrivals = Arrivals()
    for k in [0, 1, 4, 5, 6, 9, 10, 11, 12, 15, 16, 17, 18, 19]:
        arrivals.take(START + k * MS, START + k * MS)
    figures = arrivals.roll(0.02)
    assert (figures.period_s, figures.dropped) == (pytest.approx(1e-3), 6)


def test_stamps_in_pairs_are_no_losses() -> None:
    """A sensor bus that delivers two samples at a time has short and long intervals in turn."""
    arrivals = Arrivals()
    for k in range(1000):
        stamp = START + k // 2 * 2 * MS + k % 2 * 100_000
        arrivals.take(stamp, stamp)
    figures = arrivals.roll(1.0)
    assert figures.period_s == pytest.approx(1e-3, rel=0.2)
    assert figures.dropped in (0, 1)


@pytest.mark.parametrize("jump_s", [-3600.0, -2.0, 5.0, 3600.0])
def test_a_clock_jump_is_one_interruption(jump_s: float) -> None:
    arrivals = Arrivals()
    regular(arrivals, 0, 1000)
    shift = round(jump_s * 1e9)
    for k in range(1000, 2000):
        arrivals.take(START + k * MS + shift, START + k * MS + shift)
    figures = arrivals.roll(1.0)
    assert (figures.total_interruptions, figures.dropped, figures.total_out_of_order) == (1, 0, 0)
    assert figures.rate_Hz == 1000.0


def test_without_stamps_nothing_is_said_of_losses() -> None:
    arrivals = Arrivals(stamped=False)
    regular(arrivals, 0, 100)
    for k in [*range(200, 300), 300, 300]:
        arrivals.take(START + k * MS, START + k * MS)
    figures = arrivals.roll(0.2)
    assert (figures.dropped, figures.total_dropped, figures.total_duplicates) == (None, None, 0)


@given(st.lists(st.integers(-(2**62), 2**62)), st.lists(st.integers(-(2**62), 2**62)))
def test_any_stamps_are_survived(stamps: list[int], nows: list[int]) -> None:
    arrivals = Arrivals()
    for stamp, now in zip(stamps, nows, strict=False):
        arrivals.take(stamp, now)
    figures = arrivals.roll(1.0)
    assert figures.samples == min(len(stamps), len(nows))
    assert figures.dropped is not None and figures.dropped >= 0


# ------------- A paused source, a loss on the way and a full queue are distinguished where the middleware shows them.


HOUR, YEAR = 3600 * SECOND, 365 * 86_400 * SECOND
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
    return {**dict(figures.values("position")), "sentence": f"missing{figures.describe_missing()}"}


def results(values: dict[str, str]) -> tuple[str, ...]:
    keys = ("dropped", "dropped, in this node's queue", "dropped, lost on the way", "dropped, not sent")
    return tuple(values[f"position: {key}"] for key in keys)


UNKNOWN = Remarks.NOT_NUMBERED
QUEUED = "missing, 100 of them dropped by this node's queue: set input_depth higher"


@pytest.mark.parametrize(
    ("depth", "numbers_after", "wait_ms", "dropped", "sentence"),
    [
        (1000, 200, 0, ("0", "0", "100"), "missing: the source paused"),
        (1000, 280, 0, ("0", "80", "20"), "missing, 80 of them lost on the way"),
        (1000, None, 0, ("0", UNKNOWN, UNKNOWN), "missing: lost on the way, or the source paused"),
        (150, None, 150, ("100", UNKNOWN, UNKNOWN), QUEUED),
        (150, None, 100, ("0", UNKNOWN, UNKNOWN), "missing: lost on the way, or the source paused"),
        (150, 300, 150, ("100", "0", "0"), QUEUED),
    ],
    ids=[
        "paused",
        "lost on the way",
        "without numbers",
        "full queue",
        "burst shorter than the queue",
        "numbered queue",
    ],
)
def test_what_became_of_missing_samples(depth, numbers_after, wait_ms, dropped, sentence) -> None:
    """In this node's queue, lost on the way, not sent."""
    numbers = None if numbers_after is None else (range(200), range(numbers_after, numbers_after + 200))
    values = run(Losses(depth), numbers=numbers, wait_ms=wait_ms)
    assert results(values) == ("100", *dropped)
    assert values["sentence"] == sentence


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
