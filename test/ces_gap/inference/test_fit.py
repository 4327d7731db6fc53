"""Evidence and fits: whitening, planted parameters with their errors, exact cross-validation, anchored twins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from engine_plant import SIMULATION, damper, traced
from example_effects import CurrentGain, Friction, Spring
from gap_traces import ar, ar_noise
from scipy.optimize import lsq_linear
from search_examples import planted

from ces_data.arrays import F
from ces_gap.baseline.learner import NoiseModel, make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant, TraceSimulator
from ces_gap.effects.effect import Effect, EffectParameter, Setting
from ces_gap.inference import evidence as evidence_module
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.findings import bound_notes
from ces_gap.inference.fit import (
    EffectFit,
    bounds,
    count_stuck_parameters,
    estimate_parameters,
    fit_alone,
    fit_from,
    fit_together,
)
from ces_gap.inference.refinement import Refinement
from ces_gap.trace import Trace, TraceInputs

PLANT = Plant(DirectSimulator(SIMULATION))
TRACES = [traced(seed=1, seconds=1.6), traced(seed=2, seconds=1.6)]


def draw_values(seed: int, columns: int) -> list[F]:
    rng = np.random.default_rng(seed)
    return [rng.standard_normal((len(t), columns)) for t in TRACES]


def covariance_of(size: int, seed: int = 3) -> F:
    root = np.random.default_rng(seed).standard_normal((size, size))
    return 4.0 * root @ root.T


def inverse_root(matrix: F) -> F:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors / np.sqrt(values)) @ vectors.T


@pytest.mark.parametrize("noise", [make_white_noise(8.0), ar(8.0, 0.8)], ids=["white", "coloured"])
def test_marginalising_is_the_dense_inverse_root(noise: NoiseModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evidence_module, "MIN_MODE_VARIANCE", 0.0)
    features, covariance = draw_values(1, 5), covariance_of(5)
    values = draw_values(2, 2)
    evidence = gather(TRACES, PLANT, noise, features, covariance)
    whitened = evidence.whiten(values)
    expected = []
    for unit in evidence.units:
        spread = evidence.noise.whiten(features[unit.trace])[unit.ticks] @ np.linalg.cholesky(covariance)
        rows = evidence.noise.whiten(values[unit.trace])[unit.ticks]
        expected.append(inverse_root(np.eye(len(rows)) + spread @ spread.T) @ rows)
    np.testing.assert_allclose(whitened, np.concatenate(expected), atol=1e-9)


def test_noise_and_baseline_error_as_expected_become_white_with_unit_variance() -> None:
    rng = np.random.default_rng(7)
    noise, features, covariance = ar(8.0, 0.8), draw_values(1, 5), covariance_of(5)
    evidence = gather(TRACES, PLANT, noise, features, covariance)
    squares = []
    for _ in range(60):
        weights = [np.linalg.cholesky(covariance) @ rng.standard_normal(5) for _ in evidence.units]
        for unit, w in zip(evidence.units, weights, strict=True):
            error = features[unit.trace] @ w + ar_noise(len(features[unit.trace]), 8.0, 0.8, rng)
            rows = unit.project(evidence.noise.whiten(error))
            squares.append(float(rows @ rows) / len(rows))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("count", [1, 2])
def test_units_hold_every_clean_tick_once(count: int) -> None:
    noise = ar(8.0, 0.5)
    evidence = gather(TRACES[:count], PLANT, noise, draw_values(1, 3)[:count], covariance_of(3))
    assert len(evidence.units) >= 4
    for number, trace in enumerate(evidence.traces):
        ticks = np.concatenate([u.ticks for u in evidence.units if u.trace == number])
        np.testing.assert_array_equal(
            np.sort(ticks), np.flatnonzero(evidence.noise.usable_after_whitening(trace.usable))
        )
    assert np.bincount(evidence.unit_of_row).tolist() == [len(u.ticks) for u in evidence.units]


class ConstantCorrection:
    """A correction of 7 N."""

    def force(self, trace: Trace, inputs: TraceInputs, simulated: F) -> F:
        return np.full_like(simulated, 7.0)


def test_the_correction_is_in_the_plants_own_force() -> None:
    evidence = gather(
        TRACES, Plant(DirectSimulator(SIMULATION), ConstantCorrection()), make_white_noise(8.0), draw_values(1, 3), None
    )
    for trace, alone in zip(evidence.traces, evidence.alone, strict=True):
        np.testing.assert_allclose(alone, trace.simulated + 7.0)
        np.testing.assert_allclose(trace.simulated[trace.usable], damper_on(trace)[trace.usable], atol=15.0)


def damper_on(trace: Trace) -> F:
    return damper(trace.time_s, trace.inputs.position, trace.inputs.current)


class Line(Effect):
    """Linear in both of its parameters."""

    name, form = "line", "linear"
    parameters = (
        EffectParameter("offset_N", -500.0, 500.0, (10.0,), "offset", magnitude=True),
        EffectParameter("stiffness_N_m", -2e4, 2e4, (100.0,), "stiffness"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] + values[1] * inputs.position)


class Useless(Effect):
    """Changes nothing, whatever its parameter."""

    name, form = "useless", "none"
    parameters = (EffectParameter("nothing", 0.0, 1.0, (0.5,), "nothing"),)


class BadlyScaled(Effect):
    """Parameters sixteen orders of magnitude apart."""

    name, form = "badly", "scaled"
    parameters = (
        EffectParameter("tiny", 0.0, 1e-7, (1e-9,), "of 1e10 N", magnitude=True),
        EffectParameter("huge", 0.0, 1e9, (1e8,), "of 1e-6 N s/m"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + 1e10 * values[0] * np.tanh(inputs.speed / 0.05) + 1e-6 * values[1] * inputs.speed)


@dataclass(frozen=True)
class Compliance(Effect):
    """A spring, searched as its inverse."""

    name, form = "compliance", "inverse"
    parameters = (
        EffectParameter("stiffness", 1e3, 1e9, (1e5,), "in series", scale="inverse", magnitude=True, neutral=np.inf),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force - force * np.abs(force) / values[0])


def errors(fit: EffectFit, *values: float) -> F:
    """Deviation of the fitted parameters from the planted ones in standard errors."""
    parameters = [p for e in fit.effects for p in e.parameters]
    true = [p.to_search(v) for p, v in zip(parameters, values, strict=True)]
    return np.asarray((fit.searched - true) / np.sqrt(np.diag(fit.covariance)))


def columns(evidence: Evidence) -> F:
    """Derivatives of the whitened force by the parameters of `Line` (r, 2)."""
    return evidence.whiten([np.stack([np.ones(len(t)), t.inputs.position], axis=1) for t in evidence.traces])


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (Line(), (25.0, -1500.0)),
        (Friction(), (40.0, 0.05)),
        (CurrentGain(), (1.07,)),
        (BadlyScaled(), (5e-9, 2e8)),
        (Compliance(), (2e4,)),
    ],
    ids=lambda x: x.name if isinstance(x, Effect) else "",
)
def test_planted_parameters_are_recovered_within_their_errors(effect: Effect, values: tuple[float, ...]) -> None:
    fit = fit_alone(planted(Setting(effect, values)), effect)
    assert np.abs(errors(fit, *values)).max() < 4.0
    assert fit.composition.settings[0].values == pytest.approx(values, rel=0.1)
    assert fit.residual @ fit.residual == pytest.approx(len(fit.residual), rel=0.06)
    assert fit.cost >= fit.residual @ fit.residual


def test_a_parameter_beyond_its_bound_ends_there_and_the_others_are_fitted() -> None:
    beyond = Line()
    evidence = planted(Setting(beyond, (700.0, 1500.0)))
    fit = fit_alone(evidence, beyond)
    low, high = bounds((beyond,))
    best = lsq_linear(columns(evidence), evidence.residual(evidence.alone), (low, high)).x
    assert best[0] == pytest.approx(500.0)
    np.testing.assert_allclose(fit.searched, best, rtol=1e-3)
    assert (fit.by_unit >= low).all() and (fit.by_unit <= high).all()


class WideLine(Line):
    """The same, for machines with larger offsets than are usual."""

    parameters = (
        EffectParameter("offset_N", -5e3, 5e3, (10.0,), "offset", magnitude=True, usual=(-500.0, 500.0)),
        Line.parameters[1],
    )


def notes(fit: EffectFit) -> tuple[str, ...]:
    return bound_notes(fit.composition, estimate_parameters(fit))


@pytest.mark.parametrize("together", [False, True], ids=["alone", "together"])
def test_a_parameter_at_the_bound_of_its_usual_range_is_fitted_again_within_all_that_is_plausible(
    together: bool,
) -> None:
    evidence = planted(Setting(WideLine(), (700.0, 1500.0)))
    fit = fit_alone(evidence, WideLine())
    fit = fit_together(evidence, [fit, fit_alone(evidence, Friction())]) if together else fit
    assert fit.composition.settings[0].values == pytest.approx((700.0, 1500.0), rel=0.05)
    assert count_stuck_parameters(fit) == 0
    assert notes(fit)[0] == "line: offset_N of 700 is outside the usual range of dampers, -500 to 500"


def test_a_fit_inside_the_usual_range_does_not_depend_on_what_is_plausible_beyond() -> None:
    evidence = planted(Setting(Line(), (25.0, -1500.0)))
    usual, wide = fit_alone(evidence, Line()), fit_alone(evidence, WideLine())
    np.testing.assert_array_equal(usual.searched, wide.searched)
    assert notes(wide) == ()


@pytest.mark.parametrize(("offset_N", "side"), [(700.0, "500 or more"), (-700.0, "-500 or less")])
def test_a_parameter_at_the_bound_of_what_is_plausible_is_said(offset_N: float, side: str) -> None:
    fit = fit_alone(planted(Setting(WideLine(), (offset_N, 1500.0))), Line())
    assert notes(fit) == (f"line: offset_N is at its bound of {side[:-8]}: read it as {side}",)
    assert count_stuck_parameters(fit) == 1


def test_a_parameter_without_influence_does_no_harm() -> None:
    evidence = planted(Setting(Spring(), (3000.0,)))
    fit = fit_together(evidence, [fit_alone(evidence, Spring()), fit_alone(evidence, Useless())])
    assert fit.names == ("spring", "useless")
    assert fit.searched[0] == pytest.approx(3000.0, rel=0.05)
    assert np.isfinite(fit.left_out).all() and not np.isnan(fit.covariance).any()
    assert estimate_parameters(fit)[1][0].ci95 == (0.0, 1.0)


def test_linearised_cross_validation_is_exact_for_a_linear_effect() -> None:
    evidence = planted(Setting(Line(), (25.0, -1500.0)))
    fit = fit_alone(evidence, Line())
    design = columns(evidence)
    target, unit = evidence.residual(evidence.alone), evidence.unit_of_row
    for k in range(len(evidence.units)):
        refitted = np.linalg.lstsq(design[unit != k], target[unit != k], rcond=None)[0]
        np.testing.assert_allclose(fit.by_unit[k], refitted, rtol=1e-4)
        np.testing.assert_allclose(fit.left_out[unit == k], (target - design @ refitted)[unit == k], atol=1e-4)


def test_the_covariance_is_how_estimates_scatter_over_repetitions() -> None:
    true = (25.0, -1500.0)
    fits = [fit_from(planted(Setting(Line(), (*true,)), seed=s), (Line(),), np.array(true)) for s in range(40)]
    scatter = np.cov(np.array([f.searched for f in fits]).T)
    predicted = np.mean([f.covariance for f in fits], axis=0)
    np.testing.assert_allclose(np.diag(predicted), np.diag(scatter), rtol=0.5)
    inside = [np.abs(errors(f, *true)) < 1.96 for f in fits]
    assert np.mean(inside) > 0.85


def test_non_finite_forces_are_rejected() -> None:
    class Breaking(Spring):
        def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
            return super().respond(trace, inputs, force, values) if values[0] < 4000.0 else np.full_like(force, np.nan)

    fit = fit_alone(planted(Setting(Spring(), (3900.0,)), noise_N=1.0), Breaking())
    assert fit.searched[0] == pytest.approx(3900.0, rel=0.03)


class Saturating(Effect):
    """A force of `size_N` that saturates at the speed `knee_m_s`; only the start near the true knee fits well."""

    name, form = "saturating", "tanh"
    parameters = (
        EffectParameter("size_N", 0.0, 1e4, (1.0,), "size", magnitude=True),
        EffectParameter("knee_m_s", 1e-3, 10.0, (1e-2, 0.1, 1.0, 5.0), "speed", "log"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] * np.tanh(inputs.speed / values[1]))


def test_starts_far_too_small_are_scaled_before_they_are_compared() -> None:
    evidence = planted(Setting(Saturating(), (300.0, 0.12)))
    fit = fit_alone(evidence, Saturating())
    assert np.abs(errors(fit, 300.0, 0.12)).max() < 4.0


EXACT = DirectSimulator(SIMULATION)

GAIN = 1.12


@dataclass(frozen=True)
class InexactTwin(TraceSimulator):
    """A twin that predicts two thirds of a change, with a small error."""

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        changed = EXACT.force(trace, inputs) - trace.simulated
        return np.asarray(trace.simulated + 0.67 * changed + 2.0 * np.sin(3.0 * trace.time_s))


@dataclass(frozen=True)
class CountedSimulator(TraceSimulator):
    """The simulation itself, counting how often it is run."""

    runs: list[int]

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        self.runs.append(1)
        return EXACT.force(trace, inputs)


def evidence_of(rerun: TraceSimulator) -> Evidence:
    return planted(Setting(CurrentGain(), (GAIN,)), seed=3, simulator=rerun)


def test_a_twin_is_exact_at_the_anchor_and_at_the_recorded_inputs() -> None:
    evidence = evidence_of(InexactTwin())
    fit = fit_alone(evidence, CurrentGain())
    anchored = Refinement(EXACT).anchor(evidence, fit)
    rows = zip(evidence.traces, evidence.alone, evidence.plants, anchored.plants, strict=True)
    for trace, alone, inexact, refined in rows:
        inputs = fit.composition.drive(trace, alone)
        np.testing.assert_allclose(refined.force(trace, inputs), EXACT.force(trace, inputs), atol=1e-6)
        assert np.abs(inexact.force(trace, inputs) - EXACT.force(trace, inputs)).max() > 5.0
        np.testing.assert_array_equal(refined.alone(trace), trace.simulated)
        np.testing.assert_array_equal(refined.force(trace, trace.inputs), inexact.force(trace, trace.inputs))


def test_refinement_runs_the_simulation_once_per_trace_and_round() -> None:
    evidence = evidence_of(InexactTwin())
    inexact = fit_alone(evidence, CurrentGain())
    counter = CountedSimulator([])
    refined = Refinement(counter).refine(evidence, inexact)
    assert len(counter.runs) == 2 * len(evidence.traces)
    assert inexact.searched[0] == pytest.approx(1.0 + (GAIN - 1.0) / 0.67, abs=0.02)
    assert refined.searched[0] == pytest.approx(GAIN, abs=0.005)
    assert refined.cost < inexact.cost
