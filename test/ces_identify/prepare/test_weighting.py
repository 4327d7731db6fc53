import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from residual_series import coloured, series

from ces_identify.prepare.cost import EQUAL, cost, parse_weighting, weighted_cost
from ces_observer.errors import CesError


def test_regions_weigh_and_overlaps_multiply():
    one = series(
        4,
        speed=np.array([0.0, 0.04, 0.3, -0.3]),
        current=np.array([0.3, 0.6, 0.6, 0.8]),
        position=np.array([-0.02, 0.0, 0.02, 0.0]),
    )
    words = ("zero_crossing=3", "current:0.5..0.7=2")
    np.testing.assert_array_equal(parse_weighting(words).tick_weights(one), [3.0, 6.0, 2.0, 1.0])
    np.testing.assert_array_equal(parse_weighting(["zero_crossing:0.01=5"]).tick_weights(one), [5.0, 1.0, 1.0, 1.0])
    np.testing.assert_array_equal(parse_weighting(["speed:-0.5..-0.1=0"]).tick_weights(one), [1.0, 1.0, 1.0, 0.0])
    np.testing.assert_array_equal(parse_weighting(["position:-1..-1e-2=4"]).tick_weights(one), [4.0, 1.0, 1.0, 1.0])
    np.testing.assert_array_equal(EQUAL.tick_weights(one), np.ones(4))
    assert str(parse_weighting(words)) == "zero_crossing=3 current:0.5..0.7=2" and not EQUAL


def test_stroke_ends_are_outside_the_central_share_of_the_whole_sets_stroke():
    long, short = (series(5, position=size * np.array([-1.0, -0.7, 0.0, 0.9, 1.0])) for size in (0.04, 0.02))
    weighting = parse_weighting(["stroke_ends=2"])
    np.testing.assert_array_equal(weighting.tick_weights(short), [2.0, 1.0, 1.0, 2.0, 2.0])
    over = weighting.with_common_stroke([long, short])
    np.testing.assert_array_equal(over.tick_weights(long), [2.0, 1.0, 1.0, 2.0, 2.0])
    np.testing.assert_array_equal(over.tick_weights(short), np.ones(5))
    narrow = parse_weighting(["stroke_ends:0.5=2"])
    np.testing.assert_array_equal(narrow.tick_weights(short), [2.0, 2.0, 1.0, 2.0, 2.0])


WRONG = ["zero_crossing", "zero_crossing=-1", "zero_crossing=1e9", "zero_crossing:0=2", "zero_crossing:0..1=2", ""]
WRONG += ["stroke_ends:1.2=2", "speed=2", "speed:1..0=2", "speed:nan..1=2", "force:0..1=2", "current:0..1=many"]


@pytest.mark.parametrize("word", WRONG)
def test_a_word_that_is_no_weight_is_named(word) -> None:
    with pytest.raises(CesError, match="weight="):
        parse_weighting([word])


@given(st.floats(1e-3, 1e3))
def test_equal_weights_give_the_plain_cost(weight):
    y, e = 300.0 * coloured(500, 0.9, 1), 20.0 * coloured(500, 0.5, 2)
    assert weighted_cost(y, y - e, np.full(500, weight)) == pytest.approx(cost(y, y - e), rel=1e-9)


def test_whole_weights_count_ticks_as_often():
    y, e = 300.0 * coloured(200, 0.9, 1), 20.0 * coloured(200, 0.5, 2)
    times = np.random.default_rng(1).integers(0, 4, 200)
    assert weighted_cost(y, y - e, times.astype(float)) == pytest.approx(
        cost(np.repeat(y, times), np.repeat(y - e, times))
    )


def test_nothing_weighs_or_nothing_is_simulated():
    y = coloured(50, 0.5, 1)
    assert np.isnan(weighted_cost(y, y, np.zeros(50)))
    assert weighted_cost(y, np.full(50, np.nan), np.ones(50)) == np.inf
