"""Dampers and simulations for the tests of whole diagnoses."""

from __future__ import annotations

import numpy as np
from engine_plant import F, damper

STIFFNESS = 3000.0


def wrong(time_s: F, position_m: F, current_A: F) -> F:
    """A real damper of which the simulation is a rough model, without an effect."""
    speed = np.gradient(position_m, time_s)
    bent = 60.0 * speed * np.abs(speed) + 30.0 * np.tanh(speed / 0.1)
    return np.asarray(1.05 * damper(time_s, position_m, current_A) + bent)


def sprung(time_s: F, position_m: F, current_A: F) -> F:
    """The same with a gas spring."""
    return wrong(time_s, position_m, current_A) + STIFFNESS * position_m


def strange(time_s: F, position_m: F, current_A: F) -> F:
    """The same with an effect that the library does not have."""
    speed = np.gradient(position_m, time_s)
    return np.asarray(wrong(time_s, position_m, current_A) + 120.0 * np.sin(speed / 0.08) * np.cos(4.0 * current_A))
