"""Indistinguishable effects: distances after refitting against brute force, and classes by complete linkage."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from example_effects import PLANT, CurrentGain, CurrentOffset, Friction, Rubbing, Scale, Spring, drive, whiten_by

from ces_gap.baseline.learner import NoiseModel
from ces_gap.effects.effect import Setting
from ces_gap.experiment.indistinguishable import (
    EVIDENCE,
    Probe,
    find_indistinguishable_effects,
    group_effects,
    make_evidence_whitening,
    refine_match,
    sample_tangents,
)
from ces_gap.inference.evidence import gather
from ces_gap.trace import Trace

NOISE_N = 8.0
STEPS, STILL = drive("steps"), drive("constant")


def probe(trace: Trace, noise_N: float = NOISE_N) -> Probe:
    return Probe(PLANT, [trace], whiten_by([trace], noise_N))


def test_a_signature_is_the_added_force_and_its_columns_are_its_derivatives() -> None:
    setting = Setting(Friction(), (40.0, 0.05))
    tangent = probe(STEPS, noise_N=1.0).tangent(setting)
    speed = STEPS.inputs.speed[STEPS.usable]
    expected = 40.0 * np.tanh(speed / 0.05)
    np.testing.assert_allclose(tangent.force, expected, atol=1e-9)
    by_transition = -40.0 * speed / 0.05 / np.cosh(speed / 0.05) ** 2 * np.log(1e3)  # by the share of its log range
    by_size, by_share = (tangent.q @ tangent.r).T
    np.testing.assert_allclose(by_size, expected / 40.0 * 300.0, atol=1e-6)
    np.testing.assert_allclose(by_share, by_transition, atol=0.8)


@pytest.mark.parametrize("transition", [0.02, 0.08])
def test_the_refined_distance_is_that_of_brute_force(transition: float) -> None:
    p = probe(STEPS)
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
    p = probe(STEPS)
    a = p.tangent(Setting(Scale(), (0.95,)))  # less force than the plant's: friction cannot be negative
    match = refine_match(a, [p.tangent(Setting(Friction(), (20.0, 0.05)))], p.tangent)
    assert match.setting.values[0] == pytest.approx(0.0, abs=1e-9)
    assert match.index == pytest.approx(a.size)


def test_reparametrised_effects_are_indistinguishable_and_different_ones_are_not() -> None:
    fitted = [Setting(Friction(), (40.0, 0.05)), Setting(Rubbing(), (700.0, 0.06)), Setting(Spring(), (2000.0,))]
    result = find_indistinguishable_effects(PLANT, [STEPS], fitted, whiten_by([STEPS], NOISE_N))
    assert result.classes == (("friction", "rubbing"),)
    assert result.pairs() == (("friction", "rubbing"),)
    match = result.matches["friction", "rubbing"]
    assert match.index < 0.1
    assert match.setting.values == pytest.approx((40.0 / 0.05, 0.05), rel=0.01)
    assert result.clearest_match("spring", "friction").evidence > 100.0 * EVIDENCE


def test_excitation_determines_what_is_distinguishable() -> None:
    fitted = [Setting(CurrentGain(), (1.08,)), Setting(Scale(), (1.07,)), Setting(CurrentOffset(), (0.035,))]
    still = find_indistinguishable_effects(PLANT, [STILL], fitted, whiten_by([STILL], NOISE_N))
    assert still.classes == (("current_gain", "scale", "current_offset"),)
    steps = find_indistinguishable_effects(PLANT, [STEPS], fitted, whiten_by([STEPS], NOISE_N))
    assert steps.classes == (("current_gain", "scale"),)  # the force is in proportion to the current


def test_noise_makes_effects_indistinguishable() -> None:
    fitted = [Setting(CurrentOffset(), (0.01,)), Setting(Scale(), (1.02,))]
    quiet = find_indistinguishable_effects(PLANT, [STEPS], fitted, whiten_by([STEPS], 8.0))
    loud = find_indistinguishable_effects(PLANT, [STEPS], fitted, whiten_by([STEPS], 100.0))
    assert quiet.classes == () and loud.classes == (("current_offset", "scale"),)
    assert loud.matches["scale", "current_offset"].index == pytest.approx(
        0.08 * quiet.matches["scale", "current_offset"].index, rel=0.02
    )


def test_invisible_effects_are_silent_and_in_no_class() -> None:
    fitted = [Setting(Scale(), (1.05,)), Setting(Spring(), (0.5,)), Setting(CurrentOffset(), (1e-5,))]
    result = find_indistinguishable_effects(PLANT, [STEPS], fitted, whiten_by([STEPS], NOISE_N))
    assert not result.matches and result.classes == ()


def test_the_first_form_is_matched_by_any_form() -> None:
    stiff, loose = Setting(Friction(), (40.0, 0.05)), Setting(Scale(), (1.05,))
    result = find_indistinguishable_effects(
        PLANT, [STEPS], [Setting(Spring(), (900.0,)), stiff, loose], whiten_by([STEPS], NOISE_N)
    )

    class OtherSpring(Friction):
        name = "spring"

    both = [Setting(Spring(), (900.0,)), Setting(OtherSpring(), (40.0, 0.05)), stiff, loose]
    more = find_indistinguishable_effects(PLANT, [STEPS], both, whiten_by([STEPS], NOISE_N))
    assert more.matches["friction", "spring"].index < 0.1 < result.matches["friction", "spring"].index
    assert more.matches["spring", "friction"].index == result.matches["spring", "friction"].index


def test_a_chain_is_not_one_class() -> None:
    place = {"a": 0.0, "b": 2.0, "c": 4.1, "d": 30.0}
    index = {(m, n): abs(place[m] - place[n]) for m, n in permutations(place, 2)}
    assert group_effects(list(place), index) == (("a", "b"),)  # a and c are further than the limit of 2.45
    index["b", "a"] = 9.0  # b can replace a, but a cannot replace b
    assert group_effects(list(place), index) == (("b", "c"),)
    assert group_effects(["a"], {}) == ()


def test_evidence_of_a_diagnosis_whitens_signatures_too() -> None:
    noise = NoiseModel(8.0, 8.0 * 0.8, np.array([0.6]))
    offset = [np.ones((len(t), 1)) for t in (STEPS, STILL)]
    evidence = gather([STEPS, STILL], PLANT, noise, offset, np.array([[1e12]]))
    whiten = make_evidence_whitening(evidence)
    # an offset cannot be distinguished from the baseline error
    assert np.abs(whiten(1, np.full(len(STILL), 5.0))).max() < 1e-3
    rng = np.random.default_rng(0)
    both = [rng.normal(size=len(t)) for t in (STEPS, STILL)]
    joined = np.concatenate([whiten(k, f) for k, f in enumerate(both)])
    np.testing.assert_allclose(joined, evidence.whiten(both))
