"""How a blind test uses the diagnosis: what stands for the simulation, and how many reference recordings it gets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from ces_observer.errors import CesError

RUN, PREDICTIONS, IDENTIFIED = "run", "predictions", "identified"
SIMULATIONS = (RUN, PREDICTIONS, IDENTIFIED)
MAX_REFERENCES = 2  # a case holds no more
TEXT = {
    RUN: "simulation run by the diagnosis",
    PREDICTIONS: "simulation known from recorded predictions only",
    IDENTIFIED: "model identified from the references as simulation",
}
CLASSES = ("references", "no_references", "predictions", "identified")
"""Kinds of mode with their own targets and probabilities; the first two run the simulation."""
COUNTS = ("no references", "one reference", "two references")


@dataclass(frozen=True)
class Mode:
    """`simulation` is RUN, PREDICTIONS or IDENTIFIED (a model identified from the references); raises CesError."""

    simulation: str = RUN
    references: int = MAX_REFERENCES

    def __post_init__(self) -> None:
        if self.simulation not in SIMULATIONS:
            raise CesError(f"--simulation '{self.simulation}': expected one of {', '.join(SIMULATIONS)}")
        if not 0 <= self.references <= MAX_REFERENCES:
            raise CesError(f"--references {self.references}: expected 0 to {MAX_REFERENCES}")
        if self.simulation == IDENTIFIED and self.references == 0:
            raise CesError("--simulation identified: a model is identified from references; add --references 1 or 2")

    @property
    def name(self) -> str:
        """The name of the mode's folder of results, such as `run_2`."""
        return f"{self.simulation}_{self.references}"

    @property
    def class_name(self) -> str:
        """The one of CLASSES whose targets apply."""
        if self.simulation != RUN:
            return self.simulation
        return "references" if self.references else "no_references"

    @property
    def text(self) -> str:
        """The mode in words."""
        return f"{TEXT[self.simulation]}, {COUNTS[self.references]}"


def combine_modes(simulations: Sequence[str], references: Sequence[int]) -> list[Mode]:
    """Return every mode of the two lists that is possible; raises CesError if none is.

    An identified model needs references, so that mode without references is left out beside others.
    """
    pairs = list(dict.fromkeys(product(simulations, references)))
    possible = [pair for pair in pairs if pair != (IDENTIFIED, 0)]
    return [Mode(*pair) for pair in possible or pairs]
