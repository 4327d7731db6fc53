"""What an effect leaves on held-out recordings: estimates, shrink with its interval, evidence for the verdict."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from diagnoses import named
from engine_plant import NOISE_N, SIMULATION, F, traced
from example_effects import CurrentGain, Friction, Spring
from search_examples import FRICTION, OFFSET, PLANT, planted

from ces_gap.baseline.plant import DirectSimulator, Plant, TraceSimulator
from ces_gap.diagnosis import AMBIGUOUS, NO_GAP, UNKNOWN
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.inference.fit import EffectFit, count_stuck_parameters, estimate_parameters, fit_from
from ces_gap.inference.held_out import (
    Blocks,
    Explanation,
    HeldOutScorer,
    HeldOutScores,
    apply_judgement,
    build_scorer,
    closed_share,
    cut_into_blocks,
    gaps_without_each,
    has_undetermined_effect,
)
from ces_gap.inference.judgement import Judgement, Probabilities
from ces_gap.limits import SearchLimits
from ces_gap.trace import Trace, TraceInputs


@cache
def plain_traces() -> tuple[Trace, ...]:
    return tuple(replace(traced(seed=s, seconds=10.0), noise_N=NOISE_N) for s in (1, 2, 3))


def gaps(rms_N: float, seed: int) -> list[F]:
    """A gap on each trace: slow, and of another strength every half second."""
    rng = np.random.default_rng(seed)
    forces = []
    for trace in plain_traces():
        strength = rng.gamma(4.0, 0.25, 30)[(trace.time_s / 0.5).astype(int)]
        forces.append(rms_N * strength * np.sqrt(2.0 / 1.25) * np.sin(9.0 * trace.time_s + rng.random()))
    return forces


def make_blocks(gap: list[F], seed: int, noise_N: float = NOISE_N) -> Blocks:
    """The held-out traces with a gap and noise on their simulated force."""
    rng = np.random.default_rng(1000 + seed)
    traces = [
        replace(t, force=t.simulated + g + noise_N * rng.standard_normal(len(t)))
        for t, g in zip(plain_traces(), gap, strict=True)
    ]
    return cut_into_blocks(traces, seed)


def simulated() -> list[F]:
    return [t.simulated for t in plain_traces()]


def halve_gap(gap: list[F]) -> list[F]:
    return [t.simulated + 0.5 * g for t, g in zip(plain_traces(), gap, strict=True)]


def rms_of_gap(gap: list[F]) -> float:
    squares = [g[t.usable] ** 2 for t, g in zip(plain_traces(), gap, strict=True)]
    return float(np.sqrt(np.concatenate(squares).mean()))


def test_the_rms_is_that_of_the_gap_without_the_noise() -> None:
    gap = gaps(6.0, 1)  # smaller than the noise
    squares = []
    for seed in range(40):
        blocks = make_blocks(gap, seed)
        squares.append(blocks.rms(blocks.energy(simulated()))[0] ** 2)
    error = float(np.std(squares)) / np.sqrt(len(squares))
    assert np.mean(squares) == pytest.approx(rms_of_gap(gap) ** 2, abs=4.0 * error)
    assert error < 0.02 * rms_of_gap(gap) ** 2


def test_intervals_cover_the_rms_of_the_process_and_the_shrink() -> None:
    covers, covers_shrink, widths = [], [], []
    for seed in range(40):
        gap = gaps(20.0, seed)
        blocks = make_blocks(gap, seed)
        before = blocks.energy(simulated())
        low, high = blocks.rms(before)[1]
        covers.append(low <= 20.0 <= high)
        widths.append(high - low)
        low, high = blocks.shrink(before, blocks.energy(halve_gap(gap)))[1]
        covers_shrink.append(low <= 0.5 <= high)
    assert np.mean(covers) >= 0.82 and np.mean(covers_shrink) >= 0.85
    assert np.mean(widths) < 8.0  # not by being too wide


def test_the_shrink_is_one_less_the_ratio_of_rms() -> None:
    gap = gaps(40.0, 1)
    blocks = make_blocks(gap, 1)
    before = blocks.energy(simulated())
    shrink, (low, high) = blocks.shrink(before, blocks.energy(halve_gap(gap)))
    assert shrink == pytest.approx(0.5, abs=0.02) and low < shrink < high
    assert blocks.shrink(before, before)[0] == pytest.approx(0.0)
    worse = [t.simulated - g for t, g in zip(plain_traces(), gap, strict=True)]
    assert blocks.shrink(before, blocks.energy(worse))[0] == pytest.approx(-1.0, abs=0.1)


def test_without_a_gap_the_rms_is_near_zero_and_never_complex() -> None:
    values = []
    for seed in range(10):
        blocks = make_blocks(gaps(0.0, 1), seed)
        value, (low, high) = blocks.rms(blocks.energy(simulated()))
        values.append(value)
        assert np.isfinite([value, low, high]).all() and 0.0 <= low <= high
    assert np.mean(values) < 0.15 * NOISE_N
    quieter = np.full(len(blocks.ticks), -1.0)  # less energy than the noise: nothing can shrink
    shrink, (low, high) = blocks.shrink(quieter, -quieter)
    assert shrink == 0.0 and low == 0.0 == high and blocks.shrink(quieter, quieter)[0] == 0.0


def test_noise_is_no_more_than_what_an_explanation_leaves() -> None:
    gap = gaps(6.0, 1)
    noisy = [replace(t, noise_N=2.0 * NOISE_N) for t in make_blocks(gap, 1).traces]  # the damper's own high frequencies
    loud, quiet = cut_into_blocks(noisy, 1), cut_into_blocks(noisy, 1, NOISE_N)
    assert loud.rms(loud.energy(simulated()))[0] == 0.0
    assert quiet.rms(quiet.energy(simulated()))[0] == pytest.approx(rms_of_gap(gap), rel=0.1)
    np.testing.assert_array_equal(cut_into_blocks(noisy, 1, 1e3).noise, loud.noise)


SIMULATOR = DirectSimulator(SIMULATION)

HELD_OUT = tuple(traced(seed=s) for s in (5, 6))


class Stiff(Effect):
    """A stiffness searched as its inverse."""

    name, form = "stiff", "inverse"
    parameters = (
        EffectParameter("stiffness", 1e3, 1e9, (1e5,), "in series", scale="inverse", magnitude=True, neutral=np.inf),
    )


def make_fit(effects: tuple[Effect, ...], searched: list[float], errors: list[float], apart: float = 0.0) -> EffectFit:
    """A fit with these results; units disagree by `apart` standard errors of their own."""
    at, spread = np.array(searched), np.array(errors)
    by_unit = at + apart * spread * np.array([[1.0], [-1.0], [0.5], [-0.5]]) / np.sqrt(3.0)
    nothing = np.zeros((8, len(at)))
    return EffectFit(effects, at, np.zeros(8), nothing, np.zeros(8), by_unit, np.diag(spread**2))


def test_intervals_are_of_two_standard_errors_in_si_units() -> None:
    ((size, width),) = estimate_parameters(make_fit((Friction(),), [40.0, float(np.log(0.05))], [2.0, 0.1]))
    assert (size.name, size.value) == ("coulomb_N", 40.0) and size.ci95 == pytest.approx((36.08, 43.92), abs=0.01)
    assert width.value == pytest.approx(0.05) and width.ci95 == pytest.approx((0.05 / 1.2166, 0.05 * 1.2166), rel=1e-3)
    assert not (size.at_bound or width.at_bound or size.drifts or width.drifts)


def test_what_the_effects_leave_beyond_the_noise_widens_the_intervals() -> None:
    rng = np.random.default_rng(2)
    sharp = replace(make_fit((Spring(),), [2000.0], [10.0]), jacobian=rng.standard_normal((4000, 1)))
    noisy, biased = (replace(sharp, residual=scale * rng.standard_normal(4000)) for scale in (1.0, 3.0))
    (((narrow,),), ((wide,),)) = (estimate_parameters(f) for f in (noisy, biased))
    size = float(np.linalg.norm(sharp.jacobian))
    expected = np.hypot(10.0, SearchLimits.MISFIT_ALIGNED * np.sqrt(8.0 * 4000) / size)
    assert narrow.ci95[1] - narrow.value == pytest.approx(19.6, rel=0.01)
    assert wide.ci95[1] - wide.value == pytest.approx(1.96 * expected, rel=0.05)


def test_intervals_stay_inside_the_bounds_and_in_order() -> None:
    ((size, _),) = estimate_parameters(make_fit((Friction(),), [295.0, -3.0], [20.0, 0.1]))
    assert size.ci95[1] == 300.0
    ((stiffness,),) = estimate_parameters(make_fit((Stiff(),), [1e-5], [1e-6]))
    assert stiffness.value == pytest.approx(1e5)
    assert stiffness.ci95 == pytest.approx((1e5 / 1.196, 1e5 / 0.804), rel=1e-3)


@pytest.mark.parametrize(("searched", "count"), [([300.0, -3.0], 1), ([300.0, 0.0], 2), ([0.0, -3.0], 0)])
def test_a_parameter_at_a_bound_is_marked_unless_it_is_neutral(searched: list[float], count: int) -> None:
    fit = make_fit((Friction(),), searched, [1.0, 0.1])
    assert count_stuck_parameters(fit) == count == sum(e.at_bound for e in estimate_parameters(fit)[0])


def test_units_that_disagree_make_a_parameter_drift() -> None:
    consistent, inconsistent = (make_fit((Friction(),), [40.0, -3.0], [2.0, 0.1], apart) for apart in (1.0, 9.0))
    assert not any(e.drifts for e in estimate_parameters(consistent)[0]) and all(
        e.drifts for e in estimate_parameters(inconsistent)[0]
    )


@dataclass(frozen=True)
class ConstantTwin(TraceSimulator):
    """A twin that ignores changes of the inputs."""

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        return trace.simulated


def scorer_of(setting: Setting, cheap: TraceSimulator = SIMULATOR) -> HeldOutScorer:
    rng = np.random.default_rng(2)
    composition = Composition((setting,))
    traces = [
        replace(
            t,
            force=Plant(SIMULATOR).with_effects(composition, t) + NOISE_N * rng.standard_normal(len(t)),
            noise_N=NOISE_N,
        )
        for t in HELD_OUT
    ]
    return build_scorer(cut_into_blocks(traces, 1), Plant(cheap), SIMULATOR)


def explain(scorer: HeldOutScorer, fit: EffectFit, exact: bool = True) -> Explanation:
    return scorer.explain(fit, scorer.forces(fit, exact))


def test_the_right_effect_leaves_nothing_and_no_effect_leaves_the_gap() -> None:
    scorer = scorer_of(Setting(Spring(), (3000.0,)))
    right = explain(scorer, make_fit((Spring(),), [3000.0], [10.0]))
    half = explain(scorer, make_fit((Spring(),), [1500.0], [10.0]))
    planted = np.concatenate([3000.0 * t.inputs.position[t.usable] for t in HELD_OUT])
    gap = float(np.sqrt(np.mean(planted**2)))
    assert right.effects == ("spring",) and right.forms == ("linear",)
    assert right.gap_after_N < 0.2 * NOISE_N and right.shrink > 0.95
    assert half.gap_after_N == pytest.approx(0.5 * gap, rel=0.05) and half.shrink == pytest.approx(0.5, abs=0.05)
    assert half.shrink_ci95[0] < 0.5 < half.shrink_ci95[1] or half.shrink_ci95[1] - half.shrink_ci95[0] < 0.05
    nothing = scorer.explain()
    assert nothing.effects == () and nothing.shrink == pytest.approx(0.0, abs=1e-6)
    assert nothing.gap_after_N == pytest.approx(gap, rel=0.03)


def test_only_exact_scores_run_the_simulation() -> None:
    scorer = scorer_of(Setting(CurrentGain(), (1.1,)), ConstantTwin())
    fit = make_fit((CurrentGain(),), [1.1], [0.01])
    assert explain(scorer, fit).shrink > 0.9
    assert explain(scorer, fit, False).shrink == pytest.approx(0.0, abs=1e-6)


@cache
def scores_of_named() -> HeldOutScores:
    nothing = replace(named().composition, effects=(), forms=(), gap_after_N=36.1, shrink=0.0, shrink_ci95=(0.0, 0.0))
    return HeldOutScores(named().gap, 4.0, named().causes, named().composition, named().held_out, nothing, 36.1)


def test_the_closed_share_is_that_of_the_energy_beyond_the_correction() -> None:
    share = closed_share(
        named().gap, replace(named().composition, gap_after_N=18.05, shrink_ci95=(0.0, 1.0 - 12.0 / 36.1))
    )
    assert share.value == pytest.approx(0.75) and share.low == pytest.approx(0.0)
    assert share.high == pytest.approx(1.0 - (12.0 / 36.1) ** 2)
    assert np.isnan(closed_share(replace(named().gap, corrected_N=0.0), named().composition).value)


@pytest.mark.parametrize(("verdict", "after_N"), [(UNKNOWN, 50.0), (AMBIGUOUS, 36.1), (NO_GAP, 4.5)])
def test_a_composition_that_enlarges_the_gap_or_has_none_is_withdrawn(verdict: str, after_N: float) -> None:
    before = replace(scores_of_named(), composition=replace(named().composition, gap_after_N=after_N))
    odds = Probabilities(0.0, 0.2, {"friction": 0.1, "valve_lag": 0.6, "current_hysteresis": 0.1})
    scores = apply_judgement(before, Judgement(verdict, odds))
    assert scores.composition == replace(before.nothing, probability=0.0) and all(
        (s.augmented == s.corrected).all() for s in scores.series
    )
    assert (scores.causes[0].effects[0], scores.causes[0].probability) == ("valve_lag", 0.6)
    kept = apply_judgement(scores_of_named(), Judgement(UNKNOWN, odds))
    assert kept.composition == replace(named().composition, probability=0.1)


def test_an_effect_whose_interval_includes_none_is_undetermined() -> None:
    first, *others = named().composition.estimates[0]
    assert not has_undetermined_effect(named().composition)
    wide = replace(named().composition, estimates=((replace(first, ci95=(-5.0, 80.0)), *others),), gain=0.1)
    assert has_undetermined_effect(replace(wide, gain_error=0.08))
    assert not has_undetermined_effect(replace(wide, gain_error=0.04))  # it saturates, and is surely there


def test_each_effect_of_several_says_what_is_lost_without_it() -> None:
    """An offset of 30 N and friction of 40 N: without either, the other refitted, about as much of the gap is left."""
    evidence = planted(OFFSET, FRICTION)
    effects, values = zip(*((s.effect, s.values) for s in (OFFSET, FRICTION)), strict=True)
    fit = fit_from(evidence, effects, np.concatenate(values))
    scorer = build_scorer(cut_into_blocks(evidence.traces, 1, NOISE_N), PLANT, PLANT.simulation)
    without_offset, without_friction = gaps_without_each(scorer, evidence, fit)
    left = scorer.explain(fit, scorer.forces(fit, True)).gap_after_N
    learned = replace(scorer, before=9.0 * scorer.before)  # two thirds of the gap were taken by references
    assert learned.explain().shrink == pytest.approx(0.0) and scorer.explain(fit).shrink == learned.explain(fit).shrink
    assert without_offset == pytest.approx(30.0, rel=0.1)
    assert 20.0 < without_friction < 40.0 and left < 3.0
