"""A network of the real recordings beside a simulation that lacks several effects: calibration, and the causes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hydraulic_models import GROOVE, make_hydraulic
from physical_models import PLAIN_VALVE
from twin_traces import traced

from ces_gap.augmented import load_augmented, save_augmented
from ces_gap.baseline.learner import make_white_noise
from ces_gap.baseline.plant import Plant
from ces_gap.baseline.twin import STEP_S, Twin
from ces_gap.effects.effect import Composition, TwinRun
from ces_gap.effects.refitted import PARTS, StoredVolume
from ces_gap.grid import rms
from ces_gap.inference.both_sides import fit_both_sides, is_static
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.explanation import Explanation
from ces_gap.inference.fit import EffectFit, Estimate
from ces_gap.report.tables import describe_parameters
from ces_identify.simulations.simulation import FunctionSimulation
from ces_observer.errors import CesError

NOISE_N = 5.0
SOFT = make_hydraulic(PLAIN_VALVE, air=0.0, compression_m_N=2.5e-6, rebound_m_N=2e-6)
STATIC = replace(
    SOFT,
    compression_m_N=3e-9,
    rebound_m_N=3e-9,
    mount_m_N=1e-9,
    piston=replace(SOFT.piston, rows=tuple(tuple(1.2 * drop for drop in row) for row in SOFT.piston.rows)),
)
REAL, SIMULATED = Twin(SOFT, STEP_S, 0.0), Twin(STATIC, STEP_S, 0.0)


def evidence(*seeds: int) -> Evidence:
    """Recordings of the real damper, and the simulation without elasticity whose valve is too stiff."""
    traces = []
    for seed in seeds:
        trace, noise = traced(SIMULATED, seed), np.random.default_rng(seed)
        force = REAL.prepare_for(trace).recorded_force
        traces.append(replace(trace, force=force + NOISE_N * noise.standard_normal(len(force))))
    return gather(traces, Plant(SIMULATED, twin=SIMULATED), make_white_noise(NOISE_N))


@pytest.fixture(scope="module")
def fit() -> EffectFit:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ces_gap.baseline.twin_fit.KINDS", ("twin tube",))
        fit = fit_both_sides(evidence(1, 2), PARTS, 2)
    assert fit is not None
    return fit


def test_what_the_simulation_lacks_is_told_from_its_calibration(fit: EffectFit) -> None:
    """Found on two recordings, it closes the gap on a third, and its numbers are those of the real damper."""
    assert fit.names[:2] == ("calibration", "compressibility")
    unseen = evidence(3)
    (force,), (trace,) = unseen.forces(fit.composition), unseen.traces
    assert rms(trace.force - force) < 0.3 * rms(trace.force - trace.simulated)
    part = fit.effects[1]
    assert isinstance(part, StoredVolume)
    assert part.before.compression_m_N < 0.2 * part.after.compression_m_N
    assert "Stiffness of the compression chamber [kN/mm]" in part.read_quantities()
    texts = describe_parameters([Estimate("share", 1.0, (0.9, 1.1))], fit.composition.settings[1])
    estimates, alone = ((Estimate("share", 1.0, (0.9, 1.1)),),), Composition((fit.composition.settings[1],))
    shown = Explanation((part.name,), (part.form,), alone, estimates, 1.0, 0.9, (0.8, 1.0))
    frame = pytest.importorskip("pandas") and shown.to_frame()
    assert dict(zip(frame["parameter"], frame["value"], strict=True)) == {**part.read_quantities(), "share": 1.0}
    assert "kN/mm [the static map has none]" in str(texts[0]) and str(texts[-1]).startswith("share 1")


def test_without_the_part_the_network_explains_less(fit: EffectFit) -> None:
    known = evidence(1, 2)
    without = Composition(tuple(s for s in fit.composition.settings if s.name != "compressibility"))
    whole, less = (known.residual(known.forces(c)) for c in (fit.composition, without))
    assert less @ less > 2.0 * whole @ whole


def test_a_twin_with_a_groove_takes_the_numbers_of_networks_without_one() -> None:
    run = TwinRun(replace(SOFT, bypass=GROOVE), *np.zeros((3, 5)), STEP_S)
    edited = StoredVolume(STATIC, SOFT, STEP_S).edit(run, [0.0]).body
    assert edited.bypass == GROOVE and edited.compression_m_N == STATIC.compression_m_N


def test_it_survives_its_file(fit: EffectFit, tmp_path: Path) -> None:
    trace, path = evidence(3).traces[0], tmp_path / "augmented.json"
    simulation = FunctionSimulation("m:f", lambda time, x, i: np.interp(time, trace.time_s, trace.simulated))
    save_augmented(path, "m:f", fit.composition, twin=SIMULATED)
    again = load_augmented(path, lambda spec: simulation)
    assert again.composition.settings[1].effect == fit.effects[1]
    expected = SIMULATED.prepare_for(trace)
    change = expected.change(trace, trace.inputs, fit.composition)
    replayed = again.force(trace.recording)
    assert rms(replayed - trace.simulated - change) < 0.05 * rms(change)
    path.write_text(path.read_text().replace('"tick_s": ', '"tick_s": -', 2))
    with pytest.raises(CesError, match="tick_s"):
        load_augmented(path, lambda spec: simulation)


def test_a_map_is_static_and_a_damper_with_a_memory_is_not() -> None:
    traces = evidence(1, 2).traces
    maps = [replace(t, simulated=900.0 * np.tanh(t.inputs.speed / 0.1) * (0.5 + t.inputs.current)) for t in traces]
    late = [replace(t, simulated=np.roll(t.simulated, 5)) for t in maps]
    assert is_static(maps) and not is_static(late)
    assert not is_static([replace(t, simulated=REAL.prepare_for(t).recorded_force) for t in traces])
