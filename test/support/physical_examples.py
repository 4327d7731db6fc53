"""A relaxation model and a model with chambers of the sizes that identification gives, with round numbers."""

from __future__ import annotations

from math import exp

from samplings import make_sampling

from ces_observer.model import Envelope, Model, Sampling
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.curves import FlowMap, IncreasingCurve
from ces_observer.structures.physical import FrictionElement, SideForces, ValvePath
from ces_observer.structures.relaxation import Relaxation, YieldingSpring
from ces_observer.structures.structure import Structure

FLOWS = (0.004, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.2)  # [m/s]
POSITIONS, GAS = (-0.02, -0.01, 0.0, 0.01, 0.02), (-40.0, -25.0, 0.0, 30.0, 80.0)
CHARACTERISTIC = IncreasingCurve((0.1, 0.25, 0.4, 0.55, 0.7, 0.9), (0.0, 0.1, 0.25, 0.5, 0.75, 1.0))
ENVELOPE = Envelope((-0.018, 0.018), (-1.5, 1.4), (0.1, 0.9))
SAMPLING = make_sampling(outlier_m=0.004, warm_up_s=0.1)


def make_valve(delay_ticks: float = 0.0, hysteresis_A: float = 0.02) -> ValvePath:
    return ValvePath(CHARACTERISTIC, delay_ticks, hysteresis_A, rise_s=8e-3, fall_s=5e-3)


def make_relaxation(valve: ValvePath, springs: int = 3) -> Relaxation:
    elements = (
        YieldingSpring(1e5, (90.0, 80.0, 20.0)),
        YieldingSpring(3e4, (10.0, 50.0, 70.0)),
        YieldingSpring(2e3, (600.0, 600.0, 600.0)),
    )
    side = SideForces(-4e-4, 140.0, 400.0, 0.5, POSITIONS, GAS, ())
    at = (*(-flow for flow in reversed(FLOWS)), 0.0, *FLOWS)
    return Relaxation(valve, 4e-7, 5e-7, FlowMap(at, _rows(at)), elements[:springs], side, reach=2.0)


def make_chambers(valve: ValvePath, friction: int = 1, friction_growth_1_N: float = 5e-5) -> Chambers:
    check = IncreasingCurve(
        (-3000.0, -1200.0, -300.0, 0.0, 30.0, 90.0, 240.0, 600.0, 1500.0),
        (-0.11, -0.07, -0.03, 0.0, 0.02, 0.07, 0.72, 2.6, 4.3),
    )
    refill = IncreasingCurve((-3000.0, 0.0, 9.0, 30.0, 90.0, 300.0), (-0.07, 0.0, 0.18, 0.21, 0.42, 37.0))
    side = SideForces(-3e-5, 140.0, 50.0, 0.4, POSITIONS, GAS, (FrictionElement(1e5, 18.0),) * friction)
    at = (-0.004, 0.0, *FLOWS)
    flows = FlowMap(at, _rows(at))
    return Chambers(valve, 0.38, 3e-7, 1.2e-7, 3.8e-7, check, refill, flows, friction_growth_1_N, side, reach=2.0)


def make_model(structure: Structure, sampling: Sampling = SAMPLING) -> Model:
    """Return a model with the force envelope that its certificate proves."""
    model = Model(sampling, structure, ENVELOPE, (-1e9, 1e9))
    bound = model.certify().bounds["force_bound_any_input_N"]
    return Model(sampling, structure, ENVELOPE, (-bound, bound))


def _rows(at: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
    """Return a valve's forces [N], blown off by 1 / e at a flow of 10 mm/s, at three settings."""
    return tuple(
        tuple(_force(flow, level) if flow >= 0.0 else -0.6 * _force(-flow, level) for flow in at)
        for level in (300.0, 1500.0, 3000.0)
    )


def _force(flow: float, level: float) -> float:
    return level * (1.0 - exp(-flow / 0.01)) + 400.0 * flow
