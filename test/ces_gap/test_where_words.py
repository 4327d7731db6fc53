import pytest

from ces_gap.axes import DIRECTION, ELAPSED, FREQUENCY, HEAT, REVERSAL, SPEED, STROKE
from ces_gap.diagnosis import Region, Where
from ces_gap.where_words import describe, place


def axis(
    name: str, edges: list[float], energy: list[float], samples: list[float], significant: list[bool]
) -> list[Region]:
    rows = zip(edges[:-1], edges[1:], energy, samples, significant, strict=True)
    return [Region(name, a, b, e, s, 5.0, (4.0, 6.0), 0.001 if found else 0.9) for a, b, e, s, found in rows]


def where(*regions: Region) -> Where:
    return Where(regions, None, 0.001, ())


def test_neighbours_are_told_as_one_place():
    rows = axis(REVERSAL, [0.0, 0.01, 0.02, 1.5], [0.4, 0.22, 0.38], [0.04, 0.05, 0.91], [True, True, False])
    assert describe(where(*rows)) == "62 % of the gap's energy lies within 20 ms of a reversal (9 % of the time)."


def test_two_ends_are_told_together_if_they_tell_more():
    rows = axis(STROKE, [-0.03, -0.025, 0.02, 0.03], [0.3, 0.4, 0.3], [0.01, 0.97, 0.02], [True, False, True])
    assert (
        describe(where(*rows)) == "60 % of the gap's energy lies at strokes below −25 or above 20 mm (3 % of the time)."
    )


def test_the_axis_that_tells_most_is_told():
    speed = axis(SPEED, [-0.2, 0.0, 0.2], [0.3, 0.7], [0.5, 0.5], [False, True])
    stroke = axis(STROKE, [-0.02, 0.0, 0.02], [0.1, 0.9], [0.5, 0.5], [False, True])
    assert "at strokes above 0 mm" in describe(where(*speed, *stroke))


def test_frequency_is_told_only_if_nothing_else_tells_enough():
    band = axis(FREQUENCY, [0.0, 8.0, 16.0, 250.0], [0.02, 0.96, 0.02], [0.98, 0.015, 0.005], [False, True, False])
    rebound = axis(DIRECTION, [-1.0, 0.0, 1.0], [0.75, 0.25], [0.5, 0.5], [True, False])
    assert (
        describe(where(*band)) == "96 % of the gap's energy lies at frequencies from 8 to 16 Hz (2 % of the force's)."
    )
    assert describe(where(*band, *rebound)) == "75 % of the gap's energy lies in rebound (50 % of the time)."


def test_time_gives_way_to_what_the_damper_does():
    late = axis(ELAPSED, [0.0, 10.0, 20.0], [0.18, 0.82], [0.5, 0.5], [False, True])
    stroke = axis(STROKE, [-0.02, 0.0, 0.02], [0.2, 0.8], [0.5, 0.5], [False, True])
    assert "at times above 10 s" in describe(where(*late))
    assert "at strokes above 0 mm" in describe(where(*late, *stroke))


def test_a_gap_that_is_nearly_everywhere_is_called_spread_widely():
    rows = axis(DIRECTION, [-1.0, 0.0, 1.0], [0.44, 0.56], [0.5, 0.5], [False, True])
    assert (
        describe(where(*rows)) == "The gap is spread widely; 56 % of its energy lies in compression (50 % of the time)."
    )


def test_nothing_significant_is_nowhere_in_particular():
    rows = axis(STROKE, [-0.02, 0.0, 0.02], [0.1, 0.9], [0.5, 0.5], [False, False])
    assert "nowhere in particular" in describe(where(*rows))
    assert "nowhere in particular" in describe(where())


@pytest.mark.parametrize(
    ("name", "low", "high", "words"),
    [
        (STROKE, 0.02, 0.0255, "at strokes from 20 to 25.5 mm"),
        (SPEED, -0.5, -0.22, "at speeds from −0.5 to −0.22 m/s"),
        (REVERSAL, 0.05, 0.1, "50 ms to 100 ms after a reversal"),
        (REVERSAL, 0.0, 0.01, "within 10 ms of a reversal"),
        (HEAT, 1500.0, 2000.0, "at dissipated heats from 1.5 to 2 kJ"),
    ],
)
def test_a_region_has_words(name, low, high, words):
    assert place(axis(name, [low, high], [1.0], [1.0], [True])[0]) == words


def test_shares_of_one_are_told():
    rows = axis(STROKE, [-0.02, 0.0, 0.02], [0.0, 1.0], [0.9995, 0.0005], [False, True])
    assert describe(where(*rows)).startswith("100 %")
    assert "(under 0.1 % of the time)" in describe(where(*rows))
