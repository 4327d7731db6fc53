"""A slow simulation asked seldom: exact at the anchor and at the recorded inputs, and a fit mended by it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from engine_plant import NOISE_N, SIMULATION, traced
from numpy.typing import NDArray
from twin_effects import CurrentGain, Spring

from ces_gap.baseline.noise import make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant, TraceSimulator
from ces_gap.effects.effect import Composition, Setting
from ces_gap.inference.anchored_surrogate import Refinement, anchor_evidence, needs_rerun, refine_fit
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.fit import fit_alone, make_composition
from ces_gap.trace import Trace, TraceInputs

F = NDArray[np.float64]
CLEAN = tuple(traced(seed=s, seconds=4.0) for s in (1, 2))
EXACT = DirectSimulator(SIMULATION)
TRUE = 1.12


@dataclass(frozen=True)
class Dull(TraceSimulator):
    """A stand-in that knows of changes a third less than they are, and is a little off."""

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        changed = EXACT.force(trace, inputs) - trace.simulated
        return np.asarray(trace.simulated + 0.67 * changed + 2.0 * np.sin(3.0 * trace.time_s))


@dataclass(frozen=True)
class Counted(TraceSimulator):
    """The simulation itself, counting how often it is run."""

    runs: list[int]

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        self.runs.append(1)
        return EXACT.force(trace, inputs)


def evidence_of(rerun: TraceSimulator) -> Evidence:
    rng = np.random.default_rng(3)
    true = Composition((Setting(CurrentGain(), (TRUE,)),))
    traces = [
        replace(t, force=Plant(EXACT).with_effects(true, t) + NOISE_N * rng.standard_normal(len(t))) for t in CLEAN
    ]
    return gather(
        traces, Plant(rerun), make_white_noise(NOISE_N), [np.zeros((len(t), 1)) for t in traces], np.zeros((1, 1))
    )


def test_it_is_exact_at_the_anchor_and_at_the_recorded_inputs() -> None:
    evidence = evidence_of(Dull())
    fit = fit_alone(evidence, CurrentGain())
    anchored = anchor_evidence(evidence, fit, EXACT)
    rows = zip(evidence.traces, evidence.alone, evidence.plants, anchored.plants, strict=True)
    for trace, alone, dull, mended in rows:
        there = fit.composition.drive(trace, alone)
        np.testing.assert_allclose(mended.force(trace, there), EXACT.force(trace, there), atol=1e-6)
        assert np.abs(dull.force(trace, there) - EXACT.force(trace, there)).max() > 5.0
        np.testing.assert_array_equal(mended.alone(trace), trace.simulated)
        np.testing.assert_array_equal(mended.force(trace, trace.inputs), dull.force(trace, trace.inputs))


def test_it_is_near_the_simulation_between_the_two() -> None:
    evidence = evidence_of(Dull())
    fit = fit_alone(evidence, CurrentGain())
    anchored = anchor_evidence(evidence, fit, EXACT)
    (trace, *_), (alone, *_) = evidence.traces, evidence.alone
    halfway = make_composition(fit.effects, 0.5 * (fit.searched + 1.0)).drive(trace, alone)
    exact = EXACT.force(trace, halfway)
    off = np.abs(anchored.plants[0].force(trace, halfway) - exact).max()
    assert off < 0.3 * np.abs(Dull().force(trace, halfway) - exact).max()


def test_a_fit_is_mended_with_one_run_of_each_trace_in_a_round() -> None:
    evidence = evidence_of(Dull())
    dull = fit_alone(evidence, CurrentGain())
    counted = Counted([])
    mended = refine_fit(evidence, dull, counted, rounds=2)
    assert len(counted.runs) == 2 * len(CLEAN)
    assert dull.searched[0] == pytest.approx(1.0 + (TRUE - 1.0) / 0.67, abs=0.02)
    assert mended.searched[0] == pytest.approx(TRUE, abs=0.005)
    assert mended.cost < dull.cost


def test_what_does_not_change_the_inputs_needs_no_run() -> None:
    evidence = evidence_of(Dull())
    fit = fit_alone(evidence, Spring())
    counted = Counted([])
    assert refine_fit(evidence, fit, counted) is fit and not counted.runs
    assert Refinement(counted).anchor(evidence, fit) is evidence and not counted.runs
    assert needs_rerun((Spring(), CurrentGain())) and not needs_rerun((Spring(),))


def test_without_a_surrogate_nothing_is_refined() -> None:
    evidence = evidence_of(EXACT)
    fit = fit_alone(evidence, CurrentGain())
    assert Refinement().refine(evidence, fit) is fit and Refinement().anchor(evidence, fit) is evidence
