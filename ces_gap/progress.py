"""Progress reports of a diagnosis, and steps that may fail without taking the finished verdict with them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from ces_identify.jobs import describe_error
from ces_observer.errors import CesError

Progress = Callable[[str, float], None]  # the present step and the share of it that is done


def ignore_progress(step: str, share: float) -> None:
    """Report nothing."""


T = TypeVar("T")


@dataclass(frozen=True)
class OptionalSteps:
    """Runs optional steps; `notes` collects one line for each that failed."""

    notes: list[str] = field(default_factory=list)

    def run(self, what: str, step: Callable[[], T], otherwise: T) -> T:
        """Return the result of `step`, or `otherwise` if it raises; the traceback of what nobody foresaw is logged."""
        try:
            return step()
        except CesError as error:
            self.notes.append(f"{what} not available: {error}")
        except Exception as error:  # whatever it is, the rest of the diagnosis stands
            logging.getLogger(__name__).exception("%s", what)
            self.notes.append(f"{what} not available: {describe_error(error)}")
        return otherwise
