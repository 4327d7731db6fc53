"""Progress reports of a diagnosis, and steps that may fail without taking the finished verdict with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from ces_observer.errors import CesError

Progress = Callable[[str, float], None]  # the present step and the share of it that is done


def ignore_progress(step: str, share: float) -> None:
    """Report nothing."""


T = TypeVar("T")

FAILURES = (CesError, np.linalg.LinAlgError, ArithmeticError)  # no programming errors


@dataclass(frozen=True)
class OptionalSteps:
    """Runs optional steps; `notes` collects one line for each that failed."""

    notes: list[str] = field(default_factory=list)

    def run(self, what: str, step: Callable[[], T], otherwise: T) -> T:
        """Return the result of `step`; if the recordings, the simulation or the numbers prevent it, `otherwise`."""
        try:
            return step()
        except FAILURES as error:
            self.notes.append(f"{what} not available: {error}")
            return otherwise
