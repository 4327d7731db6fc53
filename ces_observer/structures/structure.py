"""What every model structure is: numbers that make a force, which can be run, proved stable, written and read.

A structure is a frozen class of its own file beside this one, named in `ces_observer.structures.STRUCTURES`. A model
file holds it under the keys it names; all the rest of the file is the same for every structure.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self

from ces_observer.json_checks import JsonObject
from ces_observer.proof.certificate import Certificate

MAX_LAG = 1000  # ticks, of any signal

Range = tuple[float, float]
Ranges = Mapping[str, Range]  # of position [m], speed [m/s] and current [A] by name


@dataclass(frozen=True)
class OperatingRange:
    """What a structure is run and proved for: the rate of its ticks, the inputs' ranges, and the force's range [N].

    Inputs are clamped to their ranges; a force outside its own ends a run.
    """

    rate_Hz: float
    inputs: Ranges
    force_N: Range


class Predictor(Protocol):
    """The free run of a structure: one force for each tick's inputs."""

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside their ranges and were clamped to them."""

    def reset(self) -> None:
        """Forget the past: forces before now count as zero, inputs before now as the first ones to come."""

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick's inputs [m, m/s, A]; infinite if it left its range."""


class Structure(ABC):
    """The part of a model that makes the force. `name` is what a model file calls it, `keys` hold its numbers
    there; `unproved` says in words what is missing where `is_stable` fails."""

    name: ClassVar[str]
    keys: ClassVar[tuple[str, ...]]
    unproved: ClassVar[str] = "its past forces are not proved to count for less than one over its input envelope"

    @property
    @abstractmethod
    def max_lag(self) -> int:
        """Longest lag of any signal in ticks."""

    @property
    @abstractmethod
    def size(self) -> str:
        """How large it is, for people."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """Return what the model file keeps, by `keys`."""

    @classmethod
    @abstractmethod
    def from_json(cls, root: JsonObject, inputs: Ranges) -> Self:
        """Check the `keys` of a model file over its ranges of inputs; raises ModelError."""

    @abstractmethod
    def make_predictor(self, within: OperatingRange) -> Predictor:
        """Return the free run, at its beginning; raises ModelError for numbers that cannot be run."""

    @abstractmethod
    def certify(self, within: OperatingRange) -> Certificate:
        """Return what can be proved of its stability: bounds that may be loose, never wrong."""

    def is_stable(self, within: OperatingRange) -> bool:
        """Prove anew, and no more than needed, that the past fades: what a vehicle asks of a model."""
        return self.certify(within).holds
