"""The desired speed-force curve: linear between its points, held beyond them, refused if it could drive."""

from __future__ import annotations

from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ces_observer.control.force_controller import CurveError, ForceCurve
from ces_observer.nodes.parameter_table import CURVE

CURVES = ForceCurve.from_points([-1.0, -0.2, 0.0, 0.5], [-900.0, -500.0, 0.0, 400.0])


def test_points_and_between_them() -> None:
    assert [CURVES.at(v) for v in (-1.0, -0.2, 0.0, 0.5)] == [-900.0, -500.0, 0.0, 400.0]
    assert CURVES.at(-0.6) == pytest.approx(-700.0)
    assert CURVES.at(0.25) == pytest.approx(200.0)


def test_the_ends_hold() -> None:
    assert CURVES.at(-50.0) == -900.0
    assert CURVES.at(1e300) == 400.0


@given(st.floats(-10.0, 10.0))
def test_it_never_drives(speed: float) -> None:
    assert speed * CURVES.at(speed) >= 0.0
    assert -900.0 <= CURVES.at(speed) <= 400.0


@pytest.mark.parametrize(
    ("speeds", "forces", "text"),
    [
        ([0.0], [0.0], "1 speeds and 1 forces"),
        ([-1.0, 1.0], [-5.0, 0.0, 5.0], "2 speeds and 3 forces"),
        ([0.0, 1.0, 1.0], [0.0, 5.0, 6.0], "rising order"),
        ([1.0, 0.0], [5.0, 0.0], "rising order"),
        ([0.0, inf], [0.0, 5.0], "not finite"),
        ([0.0, 1.0], [0.0, nan], "not finite"),
        ([-1.0, 1.0], [5.0, 5.0], "5 N at -1 m/s would drive"),
        ([-1.0, 2.0], [-100.0, 500.0], "100 N at rest"),
    ],
)
def test_a_curve_that_cannot_be_used_is_refused(speeds: list[float], forces: list[float], text: str) -> None:
    with pytest.raises(CurveError, match=text):
        ForceCurve.from_points(speeds, forces)


def test_the_default_curve_is_one() -> None:
    assert ForceCurve.from_points(*(spec.default for spec in CURVE)).at(0.0) == 0.0
