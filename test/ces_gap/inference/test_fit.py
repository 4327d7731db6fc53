"""Fitting: planted parameters come back, inside bounds and at them, however scaled; leaving out is refitting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from engine_plant import NOISE_N, SIMULATION, traced
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from twin_effects import CurrentGain, Friction, Spring

from ces_gap.baseline.noise import make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.fit import EffectFit, bounds, fit_alone, fit_together, make_composition, polish, starts
from ces_gap.trace import Trace, TraceInputs

F = NDArray[np.float64]
PLANT = Plant(DirectSimulator(SIMULATION))


class Line(Effect):
    """Linear in both of its parameters."""

    name, form = "line", "linear"
    parameters = (
        EffectParameter("offset_N", -500.0, 500.0, (10.0,), "offset", magnitude=True),
        EffectParameter("stiffness_N_m", -2e4, 2e4, (100.0,), "stiffness"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] + values[1] * inputs.position)


class Badly(Effect):
    """Parameters sixteen orders of magnitude apart."""

    name, form = "badly", "scaled"
    parameters = (
        EffectParameter("tiny", 0.0, 1e-7, (1e-9,), "of 1e10 N", magnitude=True),
        EffectParameter("huge", 0.0, 1e9, (1e8,), "of 1e-6 N s/m"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + 1e10 * values[0] * np.tanh(inputs.speed / 0.05) + 1e-6 * values[1] * inputs.speed)


class Useless(Effect):
    """Changes nothing, whatever its parameter."""

    name, form = "useless", "none"
    parameters = (EffectParameter("nothing", 0.0, 1.0, (0.5,), "nothing"),)


@dataclass(frozen=True)
class Compliance(Effect):
    """A spring, searched as its inverse."""

    name, form = "compliance", "inverse"
    parameters = (
        EffectParameter("stiffness", 1e3, 1e9, (1e5,), "in series", scale="inverse", magnitude=True, neutral=np.inf),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force - force * np.abs(force) / values[0])


@cache
def clean() -> tuple[Trace, ...]:
    return tuple(traced(seed=s, seconds=4.0) for s in (1, 2))


def planted(composition: Composition, noise_N: float = NOISE_N, seed: int = 5) -> Evidence:
    """Evidence of the plant with a composition around it, in white noise, nothing to be marginalised."""
    rng = np.random.default_rng(seed)
    traces = [
        replace(t, force=PLANT.with_effects(composition, t) + noise_N * rng.standard_normal(len(t))) for t in clean()
    ]
    return gather(traces, PLANT, make_white_noise(noise_N), [np.zeros((len(t), 1)) for t in traces], np.zeros((1, 1)))


def one(effect: Effect, *values: float) -> Composition:
    return Composition((Setting(effect, values),))


def errors(fit: EffectFit, *values: float) -> F:
    """How far the searched values are from those planted, in standard errors."""
    parameters = [p for e in fit.effects for p in e.parameters]
    true = [p.to_search(v) for p, v in zip(parameters, values, strict=True)]
    return np.asarray((fit.searched - true) / np.sqrt(np.diag(fit.covariance)))


def columns(evidence: Evidence) -> F:
    """What a line's parameters do to the whitened force (r, 2)."""
    return evidence.whiten([np.stack([np.ones(len(t)), t.inputs.position], axis=1) for t in evidence.traces])


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (Line(), (25.0, -1500.0)),
        (Friction(), (40.0, 0.05)),
        (CurrentGain(), (1.07,)),
        (Badly(), (5e-9, 2e8)),
        (Compliance(), (2e4,)),
    ],
    ids=lambda x: x.name if isinstance(x, Effect) else "",
)
def test_planted_parameters_come_back_within_their_errors(effect: Effect, values: tuple[float, ...]) -> None:
    fit = fit_alone(planted(one(effect, *values)), effect)
    assert np.abs(errors(fit, *values)).max() < 4.0
    assert fit.composition.settings[0].values == pytest.approx(values, rel=0.1)
    assert fit.residual @ fit.residual == pytest.approx(len(fit.residual), rel=0.06)
    assert fit.cost >= fit.residual @ fit.residual


def test_what_lies_beyond_a_bound_ends_at_the_bound_and_the_rest_is_fitted_there() -> None:
    beyond = Line()
    fit = fit_alone(planted(one(beyond, 700.0, 1500.0)), beyond)
    low, high = bounds((beyond,))
    evidence = planted(one(beyond, 700.0, 1500.0))
    best = lsq_linear(columns(evidence), evidence.residual(evidence.alone), (low, high)).x
    assert best[0] == pytest.approx(500.0)
    np.testing.assert_allclose(fit.searched, best, rtol=1e-3)
    assert (fit.by_unit >= low).all() and (fit.by_unit <= high).all()


def test_planted_at_its_bound_a_parameter_is_found_there() -> None:
    fit = fit_alone(planted(one(Friction(), 300.0, 0.05)), Friction())
    assert fit.composition.settings[0].values == pytest.approx((300.0, 0.05), rel=0.02)


def test_a_parameter_without_a_trace_does_no_harm() -> None:
    evidence = planted(one(Spring(), 3000.0))
    fit = fit_together(evidence, [fit_alone(evidence, Spring()), fit_alone(evidence, Useless())])
    assert fit.names == ("spring", "useless")
    assert fit.searched[0] == pytest.approx(3000.0, rel=0.05)
    assert np.isfinite(fit.left_out).all() and not np.isnan(fit.covariance).any()


def test_two_effects_are_fitted_together() -> None:
    both = Composition((Setting(Spring(), (3000.0,)), Setting(Friction(), (40.0, 0.05))))
    evidence = planted(both)
    alone = [fit_alone(evidence, Spring()), fit_alone(evidence, Friction())]
    joint = fit_together(evidence, alone)
    assert np.abs(errors(joint, 3000.0, 40.0, 0.05)).max() < 4.0
    assert joint.cost < min(a.cost for a in alone)


def test_the_linearised_leaving_out_is_refitting_for_a_linear_effect() -> None:
    evidence = planted(one(Line(), 25.0, -1500.0))
    fit = fit_alone(evidence, Line())
    design = columns(evidence)
    target, unit = evidence.residual(evidence.alone), evidence.unit_of_row
    for k in range(len(evidence.units)):
        refitted = np.linalg.lstsq(design[unit != k], target[unit != k], rcond=None)[0]
        np.testing.assert_allclose(fit.by_unit[k], refitted, rtol=1e-4)
        np.testing.assert_allclose(fit.left_out[unit == k], (target - design @ refitted)[unit == k], atol=1e-4)


def test_the_covariance_is_how_estimates_scatter_over_repetitions() -> None:
    true = (25.0, -1500.0)
    found = [polish(planted(one(Line(), *true), seed=s), (Line(),), np.array(true)) for s in range(60)]
    scatter = np.cov(np.array([f.searched for f in found]).T)
    told = np.mean([f.covariance for f in found], axis=0)
    np.testing.assert_allclose(np.diag(told), np.diag(scatter), rtol=0.5)
    inside = [np.abs(errors(f, *true)) < 1.96 for f in found]
    assert np.mean(inside) > 0.85


def test_starts_are_products_of_the_parameters_own_a_few_at_most() -> None:
    evidence = planted(Composition())
    np.testing.assert_allclose(starts(evidence, Friction()), [[20.0, np.log(0.02)], [20.0, np.log(0.3)]])

    class Many(Friction):
        parameters = tuple(replace(p, starts=tuple(np.geomspace(0.002, 0.9, 9))) for p in Friction.parameters)

    assert 2 <= len(starts(evidence, Many())) <= 6


def test_an_effect_may_choose_its_starts_by_the_longest_stroke() -> None:
    class Choosing(Spring):
        def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
            return [(1e4 * float(np.ptp(trace.inputs.position[trace.usable])),)]

    evidence = planted(Composition())
    widest = max(float(np.ptp(t.inputs.position[t.usable])) for t in evidence.traces)
    np.testing.assert_allclose(starts(evidence, Choosing()), [[1e4 * widest]])


def test_nonsense_on_the_way_is_not_taken() -> None:
    class Breaking(Spring):
        def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
            return super().respond(trace, inputs, force, values) if values[0] < 4000.0 else np.full_like(force, np.nan)

    fit = fit_alone(planted(one(Spring(), 3900.0), noise_N=1.0), Breaking())
    assert fit.searched[0] == pytest.approx(3900.0, rel=0.03)


def test_searched_values_become_settings_inside_their_bounds() -> None:
    made = make_composition((Friction(), Compliance()), np.array([1e9, np.log(0.05), 1.0 / 5e4]))
    assert made.names == ("friction", "compliance")
    assert made.settings[0].values == pytest.approx((300.0, 0.05)) and made.settings[1].values == pytest.approx((5e4,))
