"""Which structure: short fits of several, compared by their free run on the same data left out of the fits.

`BestStructure` fits the best of them in full, and of those that cannot be told apart the one with the most physics; the
fitter of a chosen structure without physics inside is compared with those with it. Both leave the comparison in the
model's provenance under `selection`: costs by structure in `structures`, and what `LEFT_OUT`, `DIFFERENCE` and `TIE`
name. Short fits are counted in work, not in time, as all fits are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ces_data.arrays import F
from ces_identify.numerics import search_clock
from ces_identify.polynomial.search_limits import THESIS, TIME_IS_UP, Listener
from ces_identify.prepare.series import Series
from ces_identify.structures import KITS, run_batch
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions, Size
from ces_identify.structures.left_out import LeftOut, choose_left_out, compare_costs, cost_of
from ces_observer.errors import CesError
from ces_observer.model import Sampling

AUTO = "auto"
LEFT_OUT, DIFFERENCE, TIE = "left_out", "structures_difference", "structures_tie"  # keys of the provenance
SHORT_WORK = 0.12  # of a short fit: one start, without exchange of terms
SHORT_THREADS = 2  # short fits at a time
SHORT_SHARE = 0.35  # of a time limit, for all short fits
CLEARLY_BETTER = 0.9  # share of the chosen structure's cost


@dataclass(frozen=True)
class BestStructure:
    """Fits the structures `names` (default: all) of these `sizes` shortly, the best of them in full; a `Fitter`."""

    sizes: Mapping[str, Size]
    names: Sequence[str] = ()

    def __call__(
        self, series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
    ) -> Fitted:
        """Return the best model; raises CesError if no structure can be fitted."""
        end = search_clock.now() + options.limits.time
        short = replace(options, limits=options.limits.within(end, SHORT_SHARE))
        found = _compare(self.names or tuple(KITS), self.sizes, series, sampling, short)
        if not found.squares:
            raise CesError("no structure could be fitted; check signals and units, or give more time")
        facts = _judge(found)
        options = replace(options, limits=options.limits.within(end))
        fitted = KITS[facts["structure"]].fitter(self.sizes)(series, sampling, options, listener)
        return replace(fitted, how={**fitted.how, **facts})


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
        others, limits = physical_structures(), options.limits
        if limits.method == THESIS or not others:
            return fitter(series, sampling, options, listener)
        end = search_clock.now() + limits.time
        fitted = fitter(series, sampling, replace(options, limits=limits.within(end, 1.0 - SHORT_SHARE)), listener)
        found = _compare((option, *others), sizes, series, sampling, replace(options, limits=limits.within(end)))
        return replace(fitted, how={**fitted.how, **_judge(found, option)}) if option in found.squares else fitted

    return fitter if KITS[option].models else fit_beside_physical_structures


def advise(costs: Mapping[str, float], chosen: str) -> str:
    """Return a sentence on a structure that is clearly better than the chosen one, or nothing."""
    best = min(costs, key=lambda name: costs[name])
    if best == chosen or costs[best] > CLEARLY_BETTER * costs[chosen]:
        return ""
    return (
        f"On data left out, a short fit of '{best}' reads J {costs[best]:.2f} %, of '{chosen}' {costs[chosen]:.2f} %: "
        f"try --structure {best} (or auto)."
    )


@dataclass(frozen=True)
class _Comparison:
    """The squared errors on left-out data (`LeftOut.squares`) by structure, of all folds together."""

    about: str
    squares: Mapping[str, F]


def _compare(
    names: Sequence[str], sizes: Mapping[str, Size], series: Sequence[Series], sampling: Sampling, how: IdentifyOptions
) -> _Comparison:
    """Fit each structure shortly, without each part of the data in turn; Ctrl-C ends it with those that are done.

    Structures that cannot be fitted, or not within the time, are left out.
    """
    folds = choose_left_out(series)
    end, late = search_clock.now() + how.limits.time, list[str]()

    def fit(name: str, fold: LeftOut) -> F | None:
        if search_clock.now() > end:
            return None
        limits = replace(how.limits.within(end), starts=1, threads=1, exchanges=False, work=SHORT_WORK)
        try:
            fitter = KITS[name].fitter(sizes)
            fitted = fitter(fold.hide(series), sampling, replace(how, limits=limits), lambda result: None)
        except CesError:
            return None
        late.extend(one.ended for one in fitted.results if one.ended == TIME_IS_UP)
        model = fitted.model
        runs = [run_batch(model, np.stack([s.position, s.speed, s.current]), s.segments) for s in series]
        squares = fold.squares(series, [force for force, _ in runs])
        return squares if np.isfinite(squares).all() else None

    found: dict[str, list[F | None]] = {}
    longest_first = sorted(names, key=lambda name: not KITS[name].models)
    with ThreadPoolExecutor(min(SHORT_THREADS, how.limits.threads)) as pool:
        running = [(name, pool.submit(fit, name, fold)) for name in longest_first for fold in folds]
        try:
            for name, one in running:
                found.setdefault(name, []).append(one.result())
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            if not found:
                raise
    whole = {
        name: np.concatenate(parts, axis=1)
        for name, rows in found.items()
        if len(parts := [row for row in rows if row is not None]) == len(folds)
    }
    return _Comparison("; ".join([*(fold.about for fold in folds), *late[:1]]), whole)


def _judge(found: _Comparison, chosen: str = "") -> dict[str, Any]:
    """Return the chosen structure, by default the best, and the comparison, for the provenance.

    Structures whose difference from the best includes none count as equal to it.
    """
    costs = {name: cost_of(squares) for name, squares in found.squares.items()}
    best, *others = sorted(costs, key=lambda name: costs[name])
    differences = [compare_costs(found.squares, best, name) for name in others]
    equal = [best, *(one.second for one in differences if one.is_none)]
    ranked = sorted(equal, key=lambda name: (not KITS[name].models, list(KITS).index(name)))
    facts: dict[str, Any] = {
        "structure": chosen or ranked[0],
        "structures": {name: round(costs[name], 4) for name in (best, *others)},
        LEFT_OUT: found.about,
    }
    if differences:
        second = differences[0]
        ends = f"{second.low:.3g} to {second.high:.3g}"
        facts[DIFFERENCE] = f"J of {second.second} is {second.ratio:.3g} times that of {best} (95 %: {ends})"
    if len(equal) > 1 and (chosen or best) in equal:
        alike = f"{', '.join(ranked[:-1])} and {ranked[-1]} cannot be told apart"
        first = "with the physics inside" if KITS[ranked[0]].models else "the first of them"
        reason = "the chosen one is among them" if chosen else f"{ranked[0]} is taken, {first}"
        facts[TIE] = f"{alike}: {reason}"
    return facts
