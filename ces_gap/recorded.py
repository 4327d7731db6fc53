"""Whether a simulation can be run, or its predictions are only recorded, however deep in augmented ones."""

from __future__ import annotations

from ces_identify.simulations.simulation import RecordedSimulation, Simulation


def recorded_in(simulation: Simulation) -> RecordedSimulation | None:
    """Return the recorded predictions that a simulation comes down to, None if it is run."""
    inside: object = simulation
    while not isinstance(inside, RecordedSimulation):
        inside = getattr(inside, "simulation", None)  # of an augmented one
        if inside is None:
            return None
    return inside
