"""Friction of seals and guides, parallel to the oil; its force reverses over some micrometres after each reversal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import exp

import numpy as np
from numba import njit

from ces_data.arrays import F
from ces_gap.effects.effect import PARALLEL, Effect, EffectParameter, TwinRun, magnitude
from ces_gap.trace import Trace, TraceInputs
from ces_observer.structures.hydraulic import FrictionElement

MIN_COULOMB_N = 1e-6  # [N] of a seal without friction
STRIBECK_M_S = 0.02  # [m/s] if it is not a parameter: typical strokes pass it within milliseconds

COULOMB = magnitude("coulomb_N", 0.0, 5e4, (20.0,), "sliding friction", usual=(0.0, 500.0))
EXCESS = EffectParameter("static_excess", 0.0, 3.0, (0.3,), "static friction over sliding friction, minus one")
STRIBECK = EffectParameter(
    "stribeck_m_s", 0.002, 0.5, (0.02, 0.1), "speed of the change from static to sliding friction", "log"
)
ROUNDING = EffectParameter("rounding_m_s", 5e-4, 0.1, (0.003, 0.03), "speed over which the direction changes", "log")
PRESLIDING = EffectParameter(
    "presliding_m", 2e-6, 0.02, (2e-5, 2e-4), "stroke over which friction reverses", "log", usual=(2e-6, 2e-3)
)
VISCOUS = EffectParameter(
    "viscous_s_m", 0.0, 1e3, (0.3,), "growth of friction with speed, over sliding friction", usual=(0.0, 10.0)
)
PRESSED = EffectParameter(
    "pressed_per_N", 0.0, 0.01, (2e-4,), "growth of friction with damper force: pressure on the seal"
)


class FrictionForce(Effect):
    name, stage = "friction", PARALLEL
    summary = "friction of seals and bearings"
    visible, mistaken_for = "after every reversal, equally at any speed", ("mount_compliance", "force_scale")
    bench = ("work", "zero_width_N")


class CoulombStribeck(FrictionForce):
    """A function of speed: F + Fc (1 + e exp(-(v/vs)²)) tanh(v/v0).

    Source: Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30 (1994). Usual are 10 to 100 N, several
    times that under side load.
    """

    form, needs = "coulomb_stribeck", "strokes that reverse, slow ones among them"
    parameters = (COULOMB, ROUNDING, EXCESS, STRIBECK)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        coulomb, rounding, excess, stribeck = values
        return force + coulomb * np.tanh(inputs.speed / rounding) * _stribeck(inputs.speed, excess, stribeck)


class Presliding(FrictionForce):
    """Dahl's model: F + Fc z, dz/dx = (1 - z sign v) / d (P. Dahl, 1968; exponent 1).

    A seal's lip follows the rod over some hundredths to tenths of a millimetre.
    """

    form, needs = "presliding", "strokes that reverse"
    parameters = (COULOMB, PRESLIDING)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        coulomb, presliding = values
        return np.asarray(force + coulomb * bristles(inputs.position, np.ones_like(force), presliding))


class LuGre(FrictionForce):
    """LuGre without micro-damping: F + Fc (z + c v), dz/dx = (1 - z sign(v)/g) / d, g = 1 + e exp(-(v/vs)²).

    Source: Canudas de Wit et al., IEEE Transactions on Automatic Control 40 (1995); vs is fixed at 20 mm/s.
    """

    form, needs = "lugre", "strokes that reverse, slow and fast ones"
    parameters = (COULOMB, PRESLIDING, EXCESS, VISCOUS)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        coulomb, presliding, excess, viscous = values
        level = _stribeck(inputs.speed, excess, STRIBECK_M_S)
        bent = bristles(inputs.position, level, presliding)
        return np.asarray(force + coulomb * (bent + viscous * inputs.speed))


class InnerSeal(FrictionForce):
    """Inside the damper, behind its mounts: a spring that yields at Fc, and more of it with the rebound pressure."""

    form, edits, needs = "seal", True, "strokes that reverse"
    parameters = (COULOMB, PRESLIDING, PRESSED)

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        coulomb, presliding, pressed = max(values[0], MIN_COULOMB_N), *values[1:]
        body, side = run.body, run.body.side
        added = FrictionElement(coulomb / presliding, coulomb)
        own = side.friction_N  # which grows as before
        growth = (body.friction_growth_1_N * own + pressed * coulomb) / (own + coulomb)
        return run.with_body(side=replace(side, friction=(*side.friction, added)), friction_growth_1_N=growth)


def _stribeck(speed: F, excess: float, stribeck: float) -> F:
    return np.asarray(1.0 + excess * np.exp(-((speed / stribeck) ** 2)))


@njit(cache=True, nogil=True)
def bristles(position: F, level: F, presliding: float) -> F:
    """Return the friction z (n,) of initially unbent bristles relative to sliding friction.

    dz/dx = (1 - z sign(dx) / level) / presliding, integrated exactly over each tick with its `level` (n,): the
    bristles tend to ±level over `presliding` * level of stroke [m] (Dahl 1968; Canudas de Wit et al. 1995).
    """
    out = np.zeros(len(position))
    z = 0.0
    for k in range(1, len(position)):
        step = position[k] - position[k - 1]
        limit = level[k] if step > 0.0 else -level[k]
        z = limit + (z - limit) * exp(-abs(step) / (presliding * level[k]))
        out[k] = z
    return out
