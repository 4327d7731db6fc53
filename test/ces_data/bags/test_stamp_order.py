import numpy as np
import pytest

from ces_data.bags.reader import LateSamples, sort_late_samples
from ces_data.limits import OrderLimits
from ces_data.recording import Channel

MS = 1_000_000
START = 7_000_000_000


def channel(stamps):
    return Channel("force", "N", stamps, np.arange(len(stamps), dtype=np.float64))


def regular(n=5000, period_ns=MS, jitter_ns=0):
    jitter = np.random.default_rng(1).integers(0, jitter_ns + 1, n)
    return START + np.arange(n) * period_ns + jitter


def store_late(stamps, rows, by):
    """Return the order in which samples are stored if those in `rows` come after the next `by`."""
    keys = np.arange(len(stamps), dtype=np.float64)
    keys[list(rows)] += by + 0.5
    return np.argsort(keys, kind="stable")


def test_channel_in_order_is_untouched():
    whole = channel(np.repeat(regular(), 2))
    assert sort_late_samples(whole) == (whole, None)
    assert sort_late_samples(whole)[0] is whole


@pytest.mark.parametrize(("rows", "by"), [([70], 1), (range(100, 5000, 37), 3), (range(100, 107), 20), ([0, 1], 90)])
def test_late_samples_are_sorted_in_with_their_values(rows, by):
    stamps = regular(jitter_ns=900_000)
    order = store_late(stamps, rows, by)
    stored = Channel("force", "N", stamps[order], order.astype(np.float64))
    found, late = sort_late_samples(stored)
    np.testing.assert_array_equal(found.stamps_ns, stamps)
    np.testing.assert_array_equal(found.values, np.arange(len(stamps)))
    assert late == LateSamples(
        len(rows), len(stamps), (np.maximum.accumulate(stored.stamps_ns) - stored.stamps_ns).max()
    )


@pytest.mark.parametrize("bursts", [2, 20])
def test_late_samples_within_bursts(bursts):
    """Log times of messages that arrive in bursts are much closer within one than between two."""
    stamps = START + np.arange(4000) // bursts * (bursts * MS) + np.arange(4000) % bursts * 20_000
    order = store_late(stamps, range(5, 3990, 31), 2)
    found, late = sort_late_samples(channel(stamps[order]))
    np.testing.assert_array_equal(found.stamps_ns, stamps)
    assert late.count > 50


def test_sample_later_than_the_window_is_left_as_it_is():
    stamps = regular()
    late = OrderLimits.MAX_LATE_NS // MS
    assert sort_late_samples(channel(stamps[store_late(stamps, [700], late)]))[1] is not None
    assert_unchanged(channel(stamps[store_late(stamps, [700], late + 1)]))


def test_clock_that_was_set_back_is_left_as_it_is():
    for back_ms, row, jitter_ns in (
        (6, 10, 0),
        (7.5, 4900, 900_000),
        (60, 2500, 0),
        (101, 10, 900_000),
        (4000, 4900, 0),
    ):
        stamps = regular(jitter_ns=jitter_ns)
        stamps[row:] -= int(back_ms * MS)
        assert_unchanged(channel(stamps))
    stamps = regular()
    stamps[3000:] -= 50 * MS
    assert_unchanged(channel(stamps[store_late(stamps, range(100, 5000, 37), 3)]))
    assert_unchanged(channel(np.tile(regular(500), 2)))  # a recording that is played again


def assert_unchanged(stored):
    found, late = sort_late_samples(stored)
    assert found is stored
    assert late is None
