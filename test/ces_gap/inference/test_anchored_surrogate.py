"""Anchored surrogates: exact at the anchor and at the recorded inputs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from engine_plant import NOISE_N, SIMULATION, traced
from example_effects import CurrentGain, Spring
from numpy.typing import NDArray

from ces_gap.baseline.learner import make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant, TraceSimulator
from ces_gap.effects.effect import Composition, Setting
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.fit import Refinement, fit_alone, make_composition
from ces_gap.trace import Trace, TraceInputs

F = NDArray[np.float64]
CLEAN = tuple(traced(seed=s, seconds=4.0) for s in (1, 2))
EXACT = DirectSimulator(SIMULATION)
GAIN = 1.12


@dataclass(frozen=True)
class InexactSurrogate(TraceSimulator):
    """A surrogate that predicts two thirds of a change, with a small error."""

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
    rng = np.random.default_rng(3)
    true = Composition((Setting(CurrentGain(), (GAIN,)),))
    traces = [
        replace(t, force=Plant(EXACT).with_effects(true, t) + NOISE_N * rng.standard_normal(len(t))) for t in CLEAN
    ]
    return gather(
        traces, Plant(rerun), make_white_noise(NOISE_N), [np.zeros((len(t), 1)) for t in traces], np.zeros((1, 1))
    )


def test_surrogate_is_exact_at_the_anchor_and_at_the_recorded_inputs() -> None:
    evidence = evidence_of(InexactSurrogate())
    fit = fit_alone(evidence, CurrentGain())
    anchored = Refinement(EXACT).anchor(evidence, fit)
    rows = zip(evidence.traces, evidence.alone, evidence.plants, anchored.plants, strict=True)
    for trace, alone, inexact, refined in rows:
        inputs = fit.composition.drive(trace, alone)
        np.testing.assert_allclose(refined.force(trace, inputs), EXACT.force(trace, inputs), atol=1e-6)
        assert np.abs(inexact.force(trace, inputs) - EXACT.force(trace, inputs)).max() > 5.0
        np.testing.assert_array_equal(refined.alone(trace), trace.simulated)
        np.testing.assert_array_equal(refined.force(trace, trace.inputs), inexact.force(trace, trace.inputs))


def test_surrogate_is_close_to_the_simulation_between_the_two() -> None:
    evidence = evidence_of(InexactSurrogate())
    fit = fit_alone(evidence, CurrentGain())
    anchored = Refinement(EXACT).anchor(evidence, fit)
    (trace, *_), (alone, *_) = evidence.traces, evidence.alone
    halfway = make_composition(fit.effects, 0.5 * (fit.searched + 1.0)).drive(trace, alone)
    exact = EXACT.force(trace, halfway)
    off = np.abs(anchored.plants[0].force(trace, halfway) - exact).max()
    assert off < 0.3 * np.abs(InexactSurrogate().force(trace, halfway) - exact).max()


def test_refinement_runs_the_simulation_once_per_trace_and_round() -> None:
    evidence = evidence_of(InexactSurrogate())
    inexact = fit_alone(evidence, CurrentGain())
    counter = CountedSimulator([])
    refined = Refinement(counter).refine(evidence, inexact)
    assert len(counter.runs) == 2 * len(CLEAN)
    assert inexact.searched[0] == pytest.approx(1.0 + (GAIN - 1.0) / 0.67, abs=0.02)
    assert refined.searched[0] == pytest.approx(GAIN, abs=0.005)
    assert refined.cost < inexact.cost


def test_effects_that_keep_the_inputs_need_no_run() -> None:
    evidence = evidence_of(InexactSurrogate())
    fit = fit_alone(evidence, Spring())
    counter = CountedSimulator([])
    assert Refinement(counter).refine(evidence, fit) is fit and not counter.runs
    assert Refinement(counter).anchor(evidence, fit) is evidence and not counter.runs


def test_without_a_surrogate_nothing_is_refined() -> None:
    evidence = evidence_of(EXACT)
    fit = fit_alone(evidence, CurrentGain())
    assert Refinement().refine(evidence, fit) is fit and Refinement().anchor(evidence, fit) is evidence
