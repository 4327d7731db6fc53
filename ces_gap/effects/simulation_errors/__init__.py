"""Errors of the simulation itself, in the form of effects: its force map and its timing.

Reference recordings teach a correction of the simulation's error. Without them these errors compete with the effects of
the library.
"""

from __future__ import annotations

from ces_gap.effects.effect import Effect
from ces_gap.effects.simulation_errors import calibration, timing


def simulation_errors() -> tuple[Effect, ...]:
    """Return every form of every error of the simulation."""
    return (*calibration.FORMS, *timing.FORMS)
