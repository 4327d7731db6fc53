"""The offline side of a model structure: how to fit it, run it in batch, set its size and show it.

Identification, simulation, campaigns, the report and the command line know a structure only through its kit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Generic, TypeVar

from ces_data.arrays import F, I, Mask
from ces_identify.numerics.core import run_batch
from ces_identify.numerics.search import Limits, Listener, SearchResult
from ces_identify.physical.models import HydraulicModels
from ces_identify.polynomial.candidate_rules import CandidateRules
from ces_identify.prepare.cost import EQUAL, Weighting
from ces_identify.prepare.series import Series, SimulatedSeries
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling
from ces_observer.options import Option
from ces_observer.structures.structure import OperatingRange, Structure
from ces_report.table import Section

Size = bool | int | float | str
UNDETERMINED = "undetermined"  # key of texts in the provenance's selection: what a user must know of a fit
AUTO = "auto"  # of a size, or the structure: the data choose


@dataclass(frozen=True)
class IdentifyOptions:
    """Options of an identification, named as those of `ces identify`.

    `split` is the share of each recording to identify on. `speed` says whether the model differentiates the position
    or needs a measured speed, too: POSITION, MEASURED, or as the recordings are (`choose_motion`). Without
    `candidates`, the built-in rules of the search method apply. `rate` [Hz] fixes the ticks. `delay` [s] is how long
    after a sample its speed is taken. `weight` sets which ticks matter more in fit and selection. With `certificate`,
    only models with one (ces_observer.proof.certificate) are considered; the thesis' procedure considers all and gives
    a certificate to the model that it finds, if the proof succeeds. With `band`, the model gets a band
    (ces_observer.model). A model forgets where it was started within `forget` [s].
    """

    split: float | None = None
    candidates: CandidateRules | None = None
    limits: Limits = field(default_factory=Limits)
    rate: float | None = None
    delay: float = 0.0
    certificate: bool = True
    weight: Weighting = EQUAL
    band: bool = True
    forget: float = 5.0
    speed: str | None = None

    def share(self, validation: Sequence[object]) -> float:
        """Return the share of each recording to identify on; without `split`, all where there are `validation` data."""
        return self.split if self.split is not None else 1.0 if validation else 0.75


def require_models(results: Sequence[SearchResult], option: str) -> list[SearchResult]:
    """Return the results with a finite cost; raises CesError if no start of a structure's fit gave one."""
    models = [result for result in results if isfinite(result.cost)]
    if not models:
        raise CesError(f"no start of the {option} fit gave a model; check signals, or give more starts or data")
    return models


def check_whole(low: int, high: int) -> Callable[[str], object]:
    """Return the check of a size that is a whole number from `low` to `high`; it raises ValueError."""

    def check(text: str) -> object:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise ValueError(f"{text!r} is not a whole number from {low} to {high}")
        return text

    return check


@dataclass(frozen=True)
class Fitted:
    """A model, the results of all starts (best first), and the selection facts for the model's provenance.

    `refit` fits the model's parameters again with a weight of 0 or 1 for each tick of the stacked series, from the
    model's own values and in a few steps; it returns None if that fails. With `leave_out_recordings`, the band also
    counts errors on whole recordings left out; a model whose curves need them all would look worse than it is.
    """

    model: Model
    results: Sequence[SearchResult]
    how: Mapping[str, Any]
    refit: Callable[[F], Model | None] | None = None
    leave_out_recordings: bool = True

    @property
    def cost(self) -> float:
        """The cost [%] of the model on the selection ticks."""
        return self.results[0].cost


# Returns the best model on prepared series; raises CesError if they hold too little.
Fitter = Callable[[Sequence[Series], Sampling, IdentifyOptions, Listener], Fitted]


S = TypeVar("S", bound=Structure)


@dataclass(frozen=True)
class StructureKit(Generic[S]):
    """One structure, offline: `about` is a short description, `body` its class in a model.

    `fitter` returns the fitter for the values of `sizes`. `batch_run` takes an operating range, inputs (3, ticks), that
    is position [m], speed [m/s] and current [A], and segments; it returns `force` and `held` of a `FreeRun`. `table`
    shows the parameters; its runs are of the role named.

    `models` is None for a structure without physics inside. `auto` fits a structure
    to recordings of at least `auto_s` seconds with the share `auto_work` of the default work, 0 for those that are not
    among its candidates.
    """

    about: str
    body: type[S]
    sizes: tuple[Option, ...]
    fitter: Callable[[Mapping[str, Size]], Fitter]
    table: Callable[[S, Model, Sequence[SimulatedSeries], str], Section]
    batch_run: Callable[[S, OperatingRange, F, I], tuple[F, Mask]] = run_batch
    models: type[HydraulicModels] | None = None
    auto_work: float = 0.0
    auto_s: float = 0.0

    @property
    def option(self) -> str:
        """The structure's name for users."""
        return self.body.option
