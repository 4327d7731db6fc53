"""Which structure: short fits of several on the same data, compared by the free run on the selection data.

`BestStructure` fits the best of them in full; the fitter of a chosen structure without physics inside reports the costs
of those with it. Both leave the costs in the model's provenance, under `selection: structures`: that of the full fit
for the chosen structure, those of short fits for the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_identify.polynomial.search_limits import THESIS, Listener
from ces_identify.prepare.series import Series
from ces_identify.structures import KITS
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions, Size
from ces_observer.errors import CesError
from ces_observer.model import Sampling

AUTO = "auto"
SHORT_S = 10.0  # most seconds of a short fit
SHORT_STARTS = 2  # of a short fit of a structure without physics inside: one start may end without a proof
SHORT_SHARE = 0.15  # of the time limit, for each short fit
CLEARLY_BETTER = 0.9  # share of the chosen structure's selection cost


@dataclass(frozen=True)
class BestStructure:
    """Fits the structures `names` (default: all) of these `sizes` shortly, the best of them in full; a `Fitter`."""

    sizes: Mapping[str, Size]
    names: Sequence[str] = ()

    def __call__(
        self, series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
    ) -> Fitted:
        """Return the best model; raises CesError if no structure can be fitted."""
        costs = _compare(self.names or tuple(KITS), self.sizes, series, sampling, options)
        if not costs:
            raise CesError("no structure could be fitted; check signals and units")
        best = min(costs, key=lambda name: costs[name])
        fitted = KITS[best].fitter(self.sizes)(series, sampling, options, listener)
        return _with_costs(fitted, best, {**costs, best: fitted.results[0].cost})


def physical_structures() -> list[str]:
    """Return the options of the structures with the physics inside."""
    return [name for name, kit in KITS.items() if kit.models]


def default_sizes() -> dict[str, Size]:
    """Return the default sizes of all structures."""
    return {size.name: size.default for kit in KITS.values() for size in kit.sizes}


def select_fitter(option: str, sizes: Mapping[str, Size]) -> Fitter:
    """Return the fitter of a structure, or of the best one; those without physics inside report the others' costs."""
    if option == AUTO:
        return BestStructure(sizes)
    fitter = KITS[option].fitter(sizes)

    def fit_beside_physical_structures(
        series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
    ) -> Fitted:
        fitted = fitter(series, sampling, options, listener)
        if options.limits.method == THESIS:
            return fitted
        costs = _compare(physical_structures(), sizes, series, sampling, options)
        return _with_costs(fitted, option, {option: fitted.results[0].cost, **costs})

    return fitter if KITS[option].models else fit_beside_physical_structures


def advise(costs: Mapping[str, float], chosen: str) -> str:
    """Return a sentence on a structure that is clearly better than the chosen one, or nothing."""
    best = min(costs, key=lambda name: costs[name])
    if best == chosen or costs[best] > CLEARLY_BETTER * costs[chosen]:
        return ""
    return (
        f"On the selection data a short fit of '{best}' reads J {costs[best]:.2f} %, '{chosen}' {costs[chosen]:.2f} %: "
        f"try --structure {best} (or auto)."
    )


def _compare(
    names: Sequence[str], sizes: Mapping[str, Size], series: Sequence[Series], sampling: Sampling, how: IdentifyOptions
) -> dict[str, float]:
    """Return the selection costs [%] of short fits, without structures that cannot be fitted; Ctrl-C ends it."""
    seconds = min(SHORT_S, SHORT_SHARE * how.limits.time)
    costs: dict[str, float] = {}
    for name in names:
        starts = 1 if KITS[name].models else SHORT_STARTS
        short = replace(how, limits=replace(how.limits, starts=starts, time=seconds))
        try:
            fitted = KITS[name].fitter(sizes)(series, sampling, short, lambda result: None)
        except CesError:
            continue
        except KeyboardInterrupt:
            break
        if np.isfinite(fitted.results[0].cost):
            costs[name] = float(fitted.results[0].cost)
    return costs


def _with_costs(fitted: Fitted, chosen: str, costs: Mapping[str, float]) -> Fitted:
    table = {name: round(cost, 4) for name, cost in sorted(costs.items(), key=lambda item: item[1])}
    return replace(fitted, how={**fitted.how, "structure": chosen, "structures": table})
