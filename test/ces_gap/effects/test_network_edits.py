"""Effects inside the damper: what they do to a network of known numbers, and that fits find what was put in."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from hydraulic_models import make_hydraulic
from made_recordings import recording_of
from physical_models import PLAIN_VALVE

from ces_data.arrays import F
from ces_gap.baseline.learner import make_white_noise
from ces_gap.baseline.plant import Plant
from ces_gap.baseline.twin import Twin, make_run
from ces_gap.effects.effect import Composition, Effect, Setting, TwinRun
from ces_gap.effects.library import library
from ces_gap.errors import GapError
from ces_gap.grid import rms
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.fit import fit_alone
from ces_gap.trace import Trace, make_trace

NOISE_N, SECONDS = 2.0, 6.0
FORMS = {f"{e.name}-{e.form}": e for e in library() if e.edits}
PLANTED = {
    "blow_off-rebound_relief": (800.0, 4e-4),
    "blow_off-compression_relief": (400.0, 3e-4),
    "blow_off-relief": (800.0, 400.0, 4e-4),
    "cavitation-starved_refill": (0.2, 0.5),
    "cavitation-starved_rebound": (0.3, 0.5),
    "compressibility-softer_oil": (4e-7,),
    "compressibility-column": (6e-7, 0.1),
    "compressibility-airy_column": (3e-7, 3.0),
    "friction-seal": (40.0, 2e-4, 1e-3),
    "gas_spring-charge": (150.0, 0.2),
    "leakage-past_piston": (5e-5,),
    "leakage-held_open": (1e-3, 2e-3),
    "leakage-past_base": (5e-5,),
    "leakage-past_all": (4e-5,),
    "mount_compliance-series": (1e6,),
    "temperature_fade-thinner_inside": (2e-4,),
    "valve_lag-path": (0.02, 0.04),
}
TWIN = Twin(make_hydraulic(PLAIN_VALVE, fade_1_W=1e-4), 0.5e-3, 1.0)
each = pytest.mark.parametrize("form", FORMS)


@cache
def trace() -> Trace:
    """Strokes of some hertz and steps of current; the simulation is the twin itself."""
    time = np.arange(round(SECONDS * 1000)) / 1000.0
    position = 0.012 * np.sin(2.0 * np.pi * 1.3 * time) + 0.005 * np.sin(2.0 * np.pi * 6.1 * time + 1.0)
    current = np.where((time * 2.7).astype(int) % 2 == 0, 0.2, 0.8)
    made = recording_of(time, position=position, current=current, force=np.zeros_like(time))
    bare = make_trace(made, np.zeros_like(time))
    own = TWIN.prepare_for(bare).recorded_force
    return replace(bare, simulated=own, force=own)


@cache
def run() -> TwinRun:
    return make_run(TWIN, trace())


def neutral(effect: Effect) -> tuple[float, ...]:
    shares = [1.0 if p.name.endswith("_share") else p.starts[0] for p in effect.parameters]
    return tuple(p.neutral if p.magnitude else share for p, share in zip(effect.parameters, shares, strict=True))


def edited(effect: Effect, values: tuple[float, ...]) -> F:
    return Composition((Setting(effect, values),)).edit(run()).force()


def planted(form: str) -> Evidence:
    """The evidence of a damper with the effect inside, in noise."""
    composition = Composition((Setting(FORMS[form], PLANTED[form]),))
    noise_N = NOISE_N * np.random.default_rng(1).standard_normal(len(trace()))
    real = replace(trace(), force=Plant(TWIN, twin=TWIN).with_effects(composition, trace()) + noise_N)
    return gather([real], Plant(TWIN, twin=TWIN), make_white_noise(NOISE_N))


@each
def test_an_edit_changes_something_but_not_at_its_neutral_value(form: str) -> None:
    effect, own = FORMS[form], run().force()
    assert rms(edited(effect, neutral(effect)) - own) < 1e-3 * rms(own)
    assert max(rms(edited(effect, values) - own) for values in effect.starts_for(trace())) > 1e-3 * rms(own)


@each
def test_an_edit_has_a_force_at_all_its_bounds(form: str) -> None:
    for values in product(*((p.low, p.high) for p in FORMS[form].parameters)):
        assert np.isfinite(edited(FORMS[form], values)).all(), values


@pytest.mark.slow
@each
def test_a_planted_edit_is_recovered(form: str) -> None:
    evidence = planted(form)
    fit = fit_alone(evidence, FORMS[form])
    gap = evidence.residual(evidence.alone)
    assert fit.residual @ fit.residual < 1.1 * len(gap) + 1e-3 * float(gap @ gap)
    (setting,) = fit.composition.settings
    within = 0.4 if "floor" in form or "air" in form else 0.1  # air acts as its product with floor or compliance
    assert setting.values == pytest.approx(PLANTED[form], rel=within)


def test_every_edit_is_planted() -> None:
    assert set(PLANTED) == set(FORMS)


def test_edits_of_a_composition_add_up_and_need_a_twin() -> None:
    leak, soft = (Setting(FORMS[f], PLANTED[f]) for f in ("leakage-past_piston", "compressibility-softer_oil"))
    both = Composition((leak, soft)).edit(run())
    np.testing.assert_allclose(both.force(), Composition((soft, leak)).edit(run()).force(), atol=1e-6)
    with pytest.raises(GapError, match="no twin"):
        Plant(TWIN).with_effects(Composition((leak,)), trace())


def test_a_changed_curve_keeps_its_nodes_and_rises() -> None:
    leaking = run().with_flow("piston", lambda flow, drop: flow + 1e-4 * drop)
    for old, new in zip(run().body.piston.rows, leaking.body.piston.rows, strict=True):
        assert (np.diff(new) > 0.0).all()
        drops, flows = np.array(old), np.array(run().body.piston.at)
        at = np.interp(drops, new, leaking.body.piston.at)
        np.testing.assert_allclose(at, flows + 1e-4 * drops, atol=1e-4 * np.ptp(flows))
    assert leaking.body.piston.at == leaking.body.base.at == leaking.body.external.at
