"""What the offline side has to know of a model structure: how to fit it, run it in batch, size it and show it.

Each structure registers one `StructureKit` in `ces_identify.structures`; identification, simulation, campaigns, the
report and the command line know structures through it alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from ces_identify.numerics.arrays import F, I
from ces_identify.polynomial.limits import Limits, Listener, SearchResult
from ces_identify.polynomial.regressors import CandidateRules, load_rules
from ces_identify.preparation.series import Series
from ces_identify.preparation.simulated_series import SimulatedSeries
from ces_identify.preparation.weighting import EQUAL, Weighting
from ces_identify.typesetting import ModelTable
from ces_observer.model import Model, Sampling
from ces_observer.structures.structure import Structure

Size = bool | int | float | str


@dataclass(frozen=True)
class IdentifyOptions:
    """What to identify and how: share of each recording to identify on, rules, limits, and numbers given by hand.

    `weighting` tells which ticks matter more in fit and selection. With `certify`, only models whose stability is
    proved (ces_observer.proof.certificate) are considered.
    """

    split: float = 0.75
    rules: CandidateRules = field(default_factory=lambda: load_rules(None))
    limits: Limits = field(default_factory=Limits)
    rate_Hz: float | None = None
    bandwidth_Hz: float | None = None
    certify: bool = True
    weighting: Weighting = EQUAL


@dataclass(frozen=True)
class Fitted:
    """A model, what every start found (best first), and how it was chosen, for the model's provenance."""

    model: Model
    found: Sequence[SearchResult]
    how: Mapping[str, Any]


class Fitter(Protocol):
    """Fits models of one structure and size."""

    def __call__(
        self, training: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
    ) -> Fitted:
        """Return the best model on prepared series; raises CesError if they hold too little."""


@dataclass(frozen=True)
class SizeOption:
    """A size of a structure that the user chooses: an option of the command line, and an axis of campaigns.

    A whole number within `whole`, or where that is None a text that passes `check`, which raises ValueError saying
    what is wrong. `expected` says in words what is taken.
    """

    name: str
    default: int | str
    meaning: str
    expected: str
    whole: tuple[int, int] | None = None
    check: Callable[[str], object] = str
    metavar: str = "N"


S = TypeVar("S", bound=Structure)


@dataclass(frozen=True)
class StructureKit(Generic[S]):
    """One structure, offline. `option` is its name for users, `about` what it is, `body` what of the model it is.

    `fitter` returns what fits models of given sizes, by the names of `sizes`. `batch_run` returns force (ticks,) [N],
    NaN from where it left the force envelope, and the first such tick or -1, of inputs (3, ticks): position [m], speed
    [m/s] and current [A]. `table` shows the numbers; the runs it may draw on are of validation if there is any.
    """

    option: str
    about: str
    body: type[S]
    sizes: tuple[SizeOption, ...]
    fitter: Callable[[Mapping[str, Size]], Fitter]
    batch_run: Callable[[S, Model, F, I], tuple[F, int]]
    table: Callable[[S, Model, Sequence[SimulatedSeries], str], ModelTable]
