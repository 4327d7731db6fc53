"""From fits to explanations: intervals in SI units, bounds, drift, and the gap left on scorer-out recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from engine_plant import NOISE_N, SIMULATION, F, traced
from example_effects import CurrentGain, Friction, Spring

from ces_gap.baseline.plant import DirectSimulator, Plant, TraceSimulator
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.inference.fit import (
    MISFIT_ALIGNED,
    EffectFit,
    count_stuck_parameters,
    estimate_parameters,
    measure_parameter_drift,
)
from ces_gap.inference.held_out import Explanation, HeldOutScorer, build_scorer, cut_into_blocks
from ces_gap.trace import Trace, TraceInputs

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
    expected = np.hypot(10.0, MISFIT_ALIGNED * np.sqrt(8.0 * 4000) / size)
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
    assert measure_parameter_drift(consistent) == pytest.approx(1.0) and measure_parameter_drift(
        inconsistent
    ) == pytest.approx(9.0)
    assert not any(e.drifts for e in estimate_parameters(consistent)[0]) and all(
        e.drifts for e in estimate_parameters(inconsistent)[0]
    )


def test_estimates_are_grouped_by_effect() -> None:
    estimates = estimate_parameters(make_fit((Spring(), Friction()), [2000.0, 40.0, -3.0], [1.0, 1.0, 0.1]))
    assert [[e.name for e in group] for group in estimates] == [["stiffness_N_m"], ["coulomb_N", "transition_m_s"]]


@dataclass(frozen=True)
class ConstantSurrogate(TraceSimulator):
    """A surrogate that ignores changes of the inputs."""

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
    scorer = scorer_of(Setting(CurrentGain(), (1.1,)), ConstantSurrogate())
    fit = make_fit((CurrentGain(),), [1.1], [0.01])
    assert explain(scorer, fit).shrink > 0.9
    assert explain(scorer, fit, False).shrink == pytest.approx(0.0, abs=1e-6)
