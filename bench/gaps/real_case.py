"""A case of `real_gaps.py`: a simulation that lacks something known, and measured recordings without references."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ces_identify.polynomial.search_limits import Limits
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation
from ces_identify.structures.kit import IdentifyOptions

SEARCH = Limits(max_terms=25, seconds=300.0, starts=4, threads=1)  # stops earlier, without candidates left
IDENTIFY = IdentifyOptions(split=1.0, limits=SEARCH)  # of models that serve as simulations


@dataclass(frozen=True)
class RealCase:
    """A simulation and recordings: what it lacks in truth, names that are right, and an independent value.

    Without names (`causes`), it lacks nothing.
    """

    name: str
    logs: tuple[str, ...]  # stems of the files that are diagnosed
    setup: str
    truth: str
    causes: tuple[str, ...]
    prepare: Callable[[], tuple[Simulation, Sequence[Recording]]]
    measure: Callable[[], str] = lambda: ""
