"""The offline side of a model structure: how to fit it, run it in batch, set its size and show it.

Identification, simulation, campaigns, the report and the command line know a structure only through its kit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from ces_identify.numerics.arrays import F, I
from ces_identify.polynomial.regressors import CandidateRules
from ces_identify.polynomial.search_limits import Limits, Listener, SearchResult
from ces_identify.preparation.series import Series
from ces_identify.preparation.simulated_series import SimulatedSeries
from ces_identify.preparation.weighting import EQUAL, Weighting
from ces_identify.typesetting import ModelTable
from ces_observer.model import Model, Sampling
from ces_observer.structures.structure import Structure

Size = bool | int | float | str


@dataclass(frozen=True)
class IdentifyOptions:
    """Options of an identification: share of each recording to identify on, candidate rules, limits, fixed sampling.

    Without `rules`, the built-in ones of the search method apply. `weighting` sets which ticks matter more in fit and
    selection. With `certify`, only models with a certificate (ces_observer.proof.certificate) are considered; the
    thesis' procedure considers all and gives a certificate to the model that it finds, if the proof succeeds.
    """

    split: float = 0.75
    rules: CandidateRules | None = None
    limits: Limits = field(default_factory=Limits)
    rate_Hz: float | None = None
    bandwidth_Hz: float | None = None
    certify: bool = True
    weighting: Weighting = EQUAL


@dataclass(frozen=True)
class Fitted:
    """A model, the results of all starts (best first), and the selection facts for the model's provenance."""

    model: Model
    results: Sequence[SearchResult]
    how: Mapping[str, Any]


# Returns the best model on prepared series; raises CesError if they hold too little.
Fitter = Callable[[Sequence[Series], Sampling, IdentifyOptions, Listener], Fitted]


@dataclass(frozen=True)
class SizeOption:
    """A size of a structure that the user chooses: an option of the command line and an axis of campaigns.

    It is a whole number within `whole` or, where that is None, a text that passes `check`, which raises ValueError.
    `expected` describes valid values.
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
    """One structure, offline. `option` is its name for users, `about` a short description, `body` its class in a model.

    `fitter` returns the fitter for the values of `sizes`. `batch_run` takes inputs (3, ticks), which are position [m],
    speed [m/s] and current [A], and segments; it returns the force (ticks,) [N], NaN from where it left the force
    envelope, and the first such tick or -1. `table` shows the parameters; its runs are of the role named.
    """

    option: str
    about: str
    body: type[S]
    sizes: tuple[SizeOption, ...]
    fitter: Callable[[Mapping[str, Size]], Fitter]
    batch_run: Callable[[S, Model, F, I], tuple[F, int]]
    table: Callable[[S, Model, Sequence[SimulatedSeries], str], ModelTable]
