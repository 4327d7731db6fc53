"""From a model to what runs it, tick by tick, whatever its structure."""

from __future__ import annotations

from typing import Protocol

from ces_observer.model import Model
from ces_observer.structures.fuzzy import FuzzyRun
from ces_observer.structures.network import NetworkRun
from ces_observer.structures.polynomial import Polynomial


class Predictor(Protocol):
    """The free run of a model: one force for each tick's inputs."""

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside the envelope and were clamped to it."""

    def reset(self) -> None:
        """Forget the past: forces before now count as zero, inputs before now as the first ones to come."""

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick's inputs [m, m/s, A]; infinite if it left the force envelope."""


def predictor(model: Model) -> Predictor:
    """Return the free run of `model`, at its beginning."""
    if model.network is not None:
        return NetworkRun(model.network, model.envelope.by_signal, model.force_envelope_N)
    if model.fuzzy is not None:
        return FuzzyRun(model.fuzzy, model.envelope.by_signal, model.force_envelope_N)
    return Polynomial(model)
