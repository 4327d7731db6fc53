"""The tools of the comparison: our structures with their defaults, and the peers, each at its best setting.

A peer is fitted with each of its settings without the selection blocks of the training data; the setting whose free run
is best on them is fitted again to all. Test data decide nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from bench.measured import regressions
from bench.measured.regressions import PLAIN, PREPARED, WITHOUT_POSITION, PeerModel
from bench.measured.ticks import Simulate, TickCase, cut_blocks, pooled_cost
from bench.measurement import is_installed
from ces_data.arrays import F
from ces_identify.polynomial.search_limits import Limits
from ces_identify.prepare.series import Series
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO, BestStructure, default_sizes
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.network import SIGMOID
from ces_observer.model import Model

OURS = (*KITS, AUTO)
REACHES_S = (0.025, 0.1, 0.4)  # of lagged inputs


@dataclass(frozen=True)
class FittedTool:
    """A model's free run, the number of its parameters, and what the tool chose."""

    simulate: Simulate
    parameters: int
    chosen: str = ""


Tool = Callable[[TickCase], FittedTool]
PeerFit = Callable[[Sequence[Series], Sequence[Series]], PeerModel]  # of estimation and selection data


def fit_ours(structure: str, case: TickCase, certificate: bool = True) -> FittedTool:
    """Identify with the defaults of `ces identify` for a structure, on all training data; without a band."""
    fitter = BestStructure(default_sizes()) if structure == AUTO else KITS[structure].fitter(default_sizes())
    options = IdentifyOptions(split=1.0, limits=Limits(threads=1), certificate=certificate, band=False)
    fitted = fitter(case.training, case.sampling, options, lambda result: None)
    parameters = int(fitted.how["parameters"]) if "parameters" in fitted.how else len(fitted.model.body.terms)
    chosen = str(fitted.how["structure"]) if structure == AUTO else ""
    return FittedTool(partial(simulate_ours, fitted.model), parameters, chosen)


def simulate_ours(model: Model, series: Series) -> F:
    return simulate_series(model, series).force


def fit_peer(settings: Mapping[str, PeerFit], case: TickCase) -> FittedTool:
    """Choose the setting on the selection blocks and fit it to all data, unless that explains these data less well."""
    estimation, selection = cut_blocks(case.training)
    first = {}
    for name, fit in settings.items():
        try:
            model = fit(estimation, selection)
            first[name] = model, pooled_cost(selection, model.simulate)
        except (ValueError, ArithmeticError, RuntimeError) as error:
            failure = error
    if not first:
        raise failure
    best = min(first, key=lambda name: first[name][1])
    model = first[best][0]
    again = model.refit(case.training) if model.refit else settings[best](case.training, [])
    kept = min((again, model), key=lambda one: pooled_cost(case.training, one.simulate))
    return FittedTool(kept.simulate, kept.parameters, best)


def peers() -> dict[str, Mapping[str, PeerFit]]:
    """Return the settings of each installed peer."""
    found: dict[str, Mapping[str, PeerFit]] = {}
    with_or_without = {"": PREPARED, ", no position": WITHOUT_POSITION}
    reaches = {
        f"lags to {1e3 * s:g} ms{words}": (s, which) for words, which in with_or_without.items() for s in REACHES_S
    }
    if is_installed("torch"):
        from bench.measured.networks import Grus, Perceptrons, fit_networks

        gru = {
            f"{units} units": partial(fit_networks, make=partial(Grus, units=units), signals=PREPARED)
            for units in (16, 32)
        }
        gru["16 units, no position"] = partial(fit_networks, make=partial(Grus, units=16), signals=WITHOUT_POSITION)
        found["GRU"] = gru
        found["lagged MLP"] = {
            words: partial(fit_networks, make=partial(Perceptrons, reach_s=s), signals=which)
            for words, (s, which) in reaches.items()
        }
    if is_installed("scikit-learn"):
        for name, fit in {
            "Gaussian process": regressions.gaussian_process,
            "boosted trees": regressions.boosted_trees,
        }.items():
            found[name] = {words: partial(fit, reach_s=s, signals=which) for words, (s, which) in reaches.items()}
    if is_installed("sysidentpy"):
        frols = partial(partial, regressions.frols)
        found["SysIdentPy"] = {
            "FROLS, 12 terms, plain": frols(terms=12, signals=PLAIN),
            "FROLS, 12 terms": frols(terms=12),
            "FROLS, 25 terms": frols(terms=25),
            "FROLS, 25 terms, degree 2, 2 lags": frols(terms=25, degree=2, lags=2),
            "FROLS, 25 terms, no past force": frols(terms=25, past_force=False),
            "MetaMSS": regressions.metamss,
            "MetaMSS, degree 2": partial(regressions.metamss, degree=2),
        }
    if is_installed("fastcan"):
        fastcan = partial(partial, regressions.fastcan)
        found["fastcan"] = {
            "12 terms, plain": fastcan(terms=12, signals=PLAIN),
            "12 terms": fastcan(terms=12),
            "25 terms": fastcan(terms=25),
            "25 terms, degree 2": fastcan(terms=25, degree=2),
            "25 terms, degree 2, 2 lags": fastcan(terms=25, degree=2, delay=2),
            "12 terms, free run": fastcan(terms=12, free_run=True),
            "12 terms, degree 2, free run": fastcan(terms=12, degree=2, free_run=True),
        }
    return found


def all_tools() -> dict[str, Tool]:
    """Return the tools by name: ours first, then peers; a sigmoid network without certificate counts as one."""
    ours = {name: partial(fit_ours, name) for name in OURS}
    free = {"free sigmoid NARX": partial(fit_ours, SIGMOID.option, certificate=False)}
    return ours | free | {name: partial(fit_peer, settings) for name, settings in peers().items()}
