"""The tools of the comparison: our structures with their defaults, and the peers, each at its best setting.

A peer is fitted with each of its settings without the selection blocks of the training data; the setting whose free run
is best on them is fitted again to all. Test data decide nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from bench.measured.regressions import (
    PLAIN,
    PREPARED,
    WITHOUT_POSITION,
    PeerModel,
    boosted_trees,
    fastcan,
    frols,
    gaussian_process,
)
from bench.measured.ticks import Simulate, TickCase, cut_blocks, pooled_cost
from bench.measurement import is_installed
from ces_identify.numerics.search import Limits
from ces_identify.prepare.series import Series
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO, BestStructure, default_sizes
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.network import SIGMOID

OURS = (*KITS, AUTO)
FREE_SIGMOID = "free sigmoid NARX"  # ours without certificate, which counts as a peer
REACHES_S = (0.025, 0.1, 0.4)  # of lagged inputs
Fitted = tuple[Simulate, str]  # a free run, and what the tool chose
PeerFit = Callable[[Sequence[Series], Sequence[Series]], PeerModel]  # of estimation and selection data


def fit_ours(structure: str, case: TickCase, certificate: bool = True) -> Fitted:
    """Identify with the defaults of `ces identify` for a structure, on all training data; without a band."""
    fitter = BestStructure(default_sizes()) if structure == AUTO else KITS[structure].fitter(default_sizes())
    options = IdentifyOptions(split=1.0, limits=Limits(threads=1), certificate=certificate, band=False)
    fitted = fitter(case.training, case.sampling, options, lambda result: None)
    model, chosen = fitted.model, str(fitted.how["structure"]) if structure == AUTO else ""
    return lambda series: simulate_series(model, series).force, chosen


def fit_peer(settings: Mapping[str, PeerFit], case: TickCase) -> Fitted:
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
    return kept.simulate, best


def lagged_settings(fit: Callable[..., PeerModel]) -> Mapping[str, PeerFit]:
    """Return the settings of a peer with lagged inputs: how far they reach, and whether the position is one."""
    signals = {"": PREPARED, ", no position": WITHOUT_POSITION}
    kinds = ((words, which, reach_s) for words, which in signals.items() for reach_s in REACHES_S)
    return {f"to {1e3 * s:g} ms{words}": partial(fit, reach_s=s, signals=which) for words, which, s in kinds}


def gru_settings() -> Mapping[str, PeerFit]:
    from bench.measured.networks import Grus, fit_networks

    return {
        "16 units": partial(fit_networks, make=partial(Grus, units=16), signals=PREPARED),
        "32 units": partial(fit_networks, make=partial(Grus, units=32), signals=PREPARED),
        "16 units, no position": partial(fit_networks, make=partial(Grus, units=16), signals=WITHOUT_POSITION),
    }


def perceptron_settings() -> Mapping[str, PeerFit]:
    from bench.measured.networks import lagged_perceptron

    return lagged_settings(lagged_perceptron)


FROLS: Mapping[str, PeerFit] = {
    "12 terms, plain": partial(frols, terms=12, signals=PLAIN),
    "12 terms": partial(frols, terms=12),
    "25 terms": partial(frols, terms=25),
    "25 terms, degree 2, 2 lags": partial(frols, terms=25, degree=2, lags=2),
    "25 terms, no past force": partial(frols, terms=25, past_force=False),
}
FASTCAN: Mapping[str, PeerFit] = {
    "12 terms, plain": partial(fastcan, terms=12, signals=PLAIN),
    "12 terms": partial(fastcan, terms=12),
    "25 terms": partial(fastcan, terms=25),
    "25 terms, degree 2": partial(fastcan, terms=25, degree=2),
    "25 terms, degree 2, 2 lags": partial(fastcan, terms=25, degree=2, lags=2),
    "12 terms, free run": partial(fastcan, terms=12, free_run=True),
    "12 terms, degree 2, free run": partial(fastcan, terms=12, degree=2, free_run=True),
}
PEERS: Mapping[str, tuple[str, Callable[[], Mapping[str, PeerFit]]]] = {  # package and settings
    "GRU": ("torch", gru_settings),
    "lagged MLP": ("torch", perceptron_settings),
    "Gaussian process": ("scikit-learn", lambda: lagged_settings(gaussian_process)),
    "boosted trees": ("scikit-learn", lambda: lagged_settings(boosted_trees)),
    "SysIdentPy": ("sysidentpy", lambda: FROLS),
    "fastcan": ("fastcan", lambda: FASTCAN),
}
TOOLS = (*OURS, FREE_SIGMOID, *PEERS)


def is_available(tool: str) -> bool:
    """Return whether a tool can be fitted here; say so if not."""
    return tool not in PEERS or is_installed(PEERS[tool][0])


def fit_tool(tool: str, case: TickCase) -> Fitted:
    if tool in PEERS:
        return fit_peer(PEERS[tool][1](), case)
    return fit_ours(SIGMOID.option, case, certificate=False) if tool == FREE_SIGMOID else fit_ours(tool, case)
