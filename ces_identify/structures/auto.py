"""Which structure: several are fitted to the end and compared by their free run on blocks that no fit has seen.

`BestStructure` takes the best, or where others are nearly as good the mean of them; the fitter of a chosen structure
without physics inside is compared with those with it. Both leave the comparison in the model's provenance under
`selection`: costs by structure in `structures`, the choice in `structure` and in words in REASON.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any

from ces_data.arrays import F
from ces_identify.limits import ChoiceLimits
from ces_identify.numerics.search import INTERRUPTED, THESIS, TIME_IS_UP, Listener, SearchResult, clock_s
from ces_identify.prepare.series import Series
from ces_identify.structures import KITS, run_batch
from ces_identify.structures.forgetting import find_forgetting
from ces_identify.structures import kit
from ces_identify.structures.kit import UNDETERMINED, Fitted, Fitter, IdentifyOptions, Size
from ces_identify.structures.mixture import mean_of
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling

AUTO = kit.AUTO
MIN_LEFT_SHARE = 0.15  # of a time limit, below which no further structure is tried
REASON = "structures_reason"  # key of the provenance


@dataclass(frozen=True)
class BestStructure:
    """Fits the structures `names` (default: those of `auto`) of these `sizes`; a `Fitter`."""

    sizes: Mapping[str, Size]
    names: Sequence[str] = ()

    def __call__(
        self, series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
    ) -> Fitted:
        """Return the best model, or the mean of the best; raises CesError if no structure can be fitted."""
        run = _Fits(self.sizes, series, sampling, options, listener)
        scored_s = sum(float(recorded.scored.sum()) / recorded.rate_Hz for recorded in series)
        usual = [name for name, kit in KITS.items() if kit.auto_work > 0.0 and kit.auto_s <= scored_s]
        work = {name: KITS[name].auto_work or 1.0 for name in self.names or usual}
        run.fit_side_by_side(work)
        for name in [name for name in run.alike() if 0.0 < KITS[name].auto_work < 1.0]:
            run.fit(name, 1.0, 1.0)
        if not run.fits:
            raise CesError("no structure could be fitted; check signals and units, or give more time")
        chosen = _choose(run.fits, run.alike())
        texts = run.describe_end(work, chosen.how)
        return replace(chosen, how={**chosen.how, UNDETERMINED: texts}) if texts else chosen


@dataclass
class _Fits:
    """Fits of several structures to the same data; `fits` holds the best of each. An interrupted one is the last."""

    sizes: Mapping[str, Size]
    series: Sequence[Series]
    sampling: Sampling
    options: IdentifyOptions
    listener: Listener

    def __post_init__(self) -> None:
        self.end_s = clock_s() + self.options.limits.time
        self.fits: dict[str, Fitted] = {}
        self._stop = threading.Event()
        self._lowest: SearchResult | None = None

    def fit_side_by_side(self, work: Mapping[str, float]) -> None:
        """Fit structures with shares of the default `work` at the same time, each whole one beside the others.

        Those with less follow the last whole one, so that the first, in this thread, which Ctrl-C reaches, ends beside
        them; which of them are hopeless is judged by those before them, for the same answer on every machine.
        """
        whole = [name for name in work if work[name] >= 1.0]
        lanes = [[(name, 1.0, len(whole) / len(work))] for name in whole] or [[]]
        shorter = [name for name in work if name not in whole]
        lanes[-1] += [(name, work[name], 1.0 / (len(shorter) - k)) for k, name in enumerate(shorter)]
        with ThreadPoolExecutor(len(lanes)) as pool:
            others = [pool.submit(self._fit_in_turn, lane) for lane in lanes[1:]]
            try:
                self._fit_in_turn(lanes[0])
                for other in others:
                    other.result()
            except KeyboardInterrupt:
                self._stop.set()
        if self._stop.is_set() and not self.fits:
            raise KeyboardInterrupt

    def _fit_in_turn(self, lane: Sequence[tuple[str, float, float]]) -> None:
        lowest = inf
        for name, work, share in lane:
            self.fit(name, work, share, ChoiceLimits.HOPELESS * lowest)
            lowest = min(lowest, self.fits[name].cost if name in self.fits else inf)

    def fit(self, name: str, work: float, share: float, hopeless: float = inf) -> None:
        """Fit a structure with a share of the default work, and of the time that is left; keep a model that forgets."""
        if self._stop.is_set():
            return
        limits = self.options.limits
        if self.fits and self.end_s - clock_s() < MIN_LEFT_SHARE * limits.time:
            return
        mine = limits.within(self.end_s, share)
        own = replace(mine, work=limits.work * work, hopeless=hopeless, stop=self._stop)
        try:
            how = replace(self.options, limits=own)
            self.listener(f"fitting {name}")
            fitted = KITS[name].fitter(self.sizes)(self.series, self.sampling, how, self._tell)
        except CesError:
            return
        except KeyboardInterrupt:
            self._stop.set()
            return
        if fitted.results[0].ended == INTERRUPTED:
            self._stop.set()
        cost = self.fits[name].cost if name in self.fits else inf
        named = [replace(result, structure=name) for result in fitted.results]
        if fitted.cost < cost and find_forgetting(fitted.model, self.series, how.forget, run_batch).suffices:
            self.fits[name] = replace(fitted, results=named)

    def describe_end(self, names: Iterable[str], how: Mapping[str, Any]) -> list[str]:
        """Return what the chosen fit does not tell, and what the time limit left out of the comparison."""
        texts, left = list(how.get(UNDETERMINED, ())), [name for name in names if name not in self.fits]
        ended = any(result.ended == TIME_IS_UP for fitted in self.fits.values() for result in fitted.results)
        if ended or (left and self.end_s - clock_s() < MIN_LEFT_SHARE * self.options.limits.time):
            without = f", without {' and '.join(left)}" if left else ""
            texts.append(f"--time ended the comparison of structures{without}: more time may make another the best")
        return texts

    def _tell(self, news: SearchResult | str) -> None:
        """Pass on the lowest cost of all structures so far, without its share of the work, which is that of one."""
        if isinstance(news, str):
            self.listener(news)
            return
        self._lowest = min(self._lowest or news, news, key=lambda result: result.cost)
        self.listener(replace(news, cost=self._lowest.cost, chosen=self._lowest.chosen, share=0.0))

    def alike(self) -> list[str]:
        """Return the structures whose cost is at most ALIKE times the least, best first."""
        costs = {name: fitted.cost for name, fitted in self.fits.items()}
        highest = ChoiceLimits.ALIKE * min(costs.values(), default=inf)
        return [name for name in sorted(costs, key=lambda name: costs[name]) if costs[name] <= highest]


def _choose(fits: Mapping[str, Fitted], alike: Sequence[str]) -> Fitted:
    """Return the only fit of `alike`, or the mean of these by 1 / J, with all costs for the provenance."""
    costs = dict(sorted(((name, fitted.cost) for name, fitted in fits.items()), key=lambda pair: pair[1]))
    shares = [1.0 / max(costs[name], 1e-9) for name in alike]
    weights = [share / sum(shares) for share in shares]
    taken = " and ".join(f"{name} ({weight:.2f})" for name, weight in zip(alike, weights, strict=True))
    reason = f"{alike[0]} is taken: the next costs more than {ChoiceLimits.ALIKE:g} times as much"
    if len(alike) > 1:
        reason = f"the mean of {taken} is taken, which cost at most {ChoiceLimits.ALIKE:g} times as much as the best"
    facts = {"structure": " and ".join(alike), "structures": _round_costs(costs), REASON: reason}
    best = fits[alike[0]]
    if len(alike) == 1:
        return replace(best, how={**best.how, **facts})
    members = [fits[name] for name in alike]
    return Fitted(
        mean_of([member.model for member in members], weights),
        [result for member in members for result in member.results],
        {
            "method": "mean of several structures",
            "parameters": sum(member.how["parameters"] for member in members),
            **facts,
        },
        partial(_refit_mean, members, weights),
        all(member.leave_out_recordings for member in members),
    )


def _refit_mean(members: Sequence[Fitted], weights: Sequence[float], ticks: F) -> Model | None:
    models = [member.refit(ticks) for member in members if member.refit is not None]
    refitted = [model for model in models if model is not None]
    return mean_of(refitted, weights) if len(refitted) == len(members) else None


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
        limits = options.limits
        if limits.method == THESIS or not physical_structures():
            return fitter(series, sampling, options, listener)
        end = clock_s() + limits.time
        longer = replace(options, limits=limits.within(end, 1.0 - ChoiceLimits.SHORT_SHARE))
        fitted = fitter(series, sampling, longer, listener)
        short = replace(options, limits=replace(limits.within(end), work=ChoiceLimits.SHORT_WORK))
        costs = {option: fitted.cost}
        for name in physical_structures():
            listener(f"fitting {name} to compare with")
            try:
                costs[name] = KITS[name].fitter(sizes)(series, sampling, short, lambda result: None).cost
            except CesError:
                continue
        return replace(fitted, how={**fitted.how, "structure": option, "structures": _round_costs(costs)})

    return fitter if KITS[option].models else fit_beside_physical_structures


def _round_costs(costs: Mapping[str, float]) -> dict[str, float]:
    return {name: round(cost, 4) for name, cost in costs.items()}


def advise(costs: Mapping[str, float], chosen: str) -> str:
    """Return a sentence on a structure that is clearly better than the chosen one, or nothing."""
    best = min(costs, key=lambda name: costs[name])
    if chosen not in costs or best == chosen or costs[best] > ChoiceLimits.CLEARLY_BETTER * costs[chosen]:
        return ""
    return (
        f"On blocks left out of the fits, '{best}' reads J {costs[best]:.2f} %, '{chosen}' {costs[chosen]:.2f} %: "
        f"try --structure {best} (or auto)."
    )
