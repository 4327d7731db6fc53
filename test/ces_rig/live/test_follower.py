"""The actuator that follows set points: exact between them, without overshoot, inside its reach."""

from __future__ import annotations

import numpy as np
import pytest

from ces_rig.live.motion import Follower


def test_a_step_is_followed_as_the_equation_says() -> None:
    follower, interval, omega = Follower(10.0, 0.1, 0.5e-3), 0.5e-3, 2 * np.pi * 10.0
    follower.set_stroke(0.02)
    stroke, speed = (np.concatenate(parts) for parts in zip(*(follower.moves(2) for _ in range(300)), strict=True))
    time = interval * np.arange(1, 601)
    assert stroke == pytest.approx(0.02 * (1.0 - (1.0 + omega * time) * np.exp(-omega * time)), abs=1e-12)
    assert speed == pytest.approx(0.02 * omega**2 * time * np.exp(-omega * time), abs=1e-10)
    assert stroke.max() <= 0.02


def test_set_points_out_of_reach_or_not_finite_do_no_harm() -> None:
    follower = Follower(60.0, 0.03, 0.5e-3)
    follower.set_stroke(1.0)
    assert follower.moves(2000)[0].max() == pytest.approx(0.03)
    follower.set_stroke(float("nan"))
    assert follower.moves(10)[0][-1] == pytest.approx(0.03)
