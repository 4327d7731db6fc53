"""Matches of effects: their distances after refitting against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from example_effects import PLANT, Friction, Scale, drive

from ces_gap.effects.effect import Setting
from ces_gap.experiment.matches import Probe, refine_match, sample_tangents

NOISE_N = 8.0
STEPS = drive("steps")


def probe(noise_N: float = NOISE_N) -> Probe:
    return Probe(PLANT, STEPS, lambda force: force[STEPS.usable] / noise_N)


def test_a_signature_is_the_added_force_and_its_columns_are_its_derivatives() -> None:
    setting = Setting(Friction(), (40.0, 0.05))
    tangent = probe(1.0).tangent(setting)
    speed = STEPS.inputs.speed[STEPS.usable]
    expected = 40.0 * np.tanh(speed / 0.05)
    np.testing.assert_allclose(tangent.force, expected, atol=1e-9)
    by_transition = -40.0 * speed / 0.05 / np.cosh(speed / 0.05) ** 2 * np.log(1e3)  # by the share of its log range
    by_size, by_share = (tangent.q @ tangent.r).T
    np.testing.assert_allclose(by_size, expected / 40.0 * 300.0, atol=1e-6)
    np.testing.assert_allclose(by_share, by_transition, atol=0.8)


@pytest.mark.parametrize("transition", [0.02, 0.08])
def test_the_refined_distance_is_that_of_brute_force(transition: float) -> None:
    p = probe()
    a = p.tangent(Setting(Scale(), (1.05,)))
    b = Setting(Friction(), (30.0, transition))
    result = refine_match(a, sample_tangents(p, p.tangent(b), a.size), p.tangent, steps=8)
    least = np.inf
    for width in np.geomspace(0.01, 1.0, 400):
        shape = np.tanh(STEPS.inputs.speed[STEPS.usable] / width) / NOISE_N
        size = np.clip(shape @ a.force / (shape @ shape), 0.0, 300.0)
        least = min(least, float(np.linalg.norm(a.force - size * shape)))
    assert 0.999 * least <= result.index <= 1.01 * least


def test_a_bound_keeps_an_effect_from_matching() -> None:
    p = probe()
    a = p.tangent(Setting(Scale(), (0.95,)))  # less force than the plant's: friction cannot be negative
    match = refine_match(a, [p.tangent(Setting(Friction(), (20.0, 0.05)))], p.tangent)
    assert match.setting.values[0] == pytest.approx(0.0, abs=1e-9)
    assert match.index == pytest.approx(a.size)
