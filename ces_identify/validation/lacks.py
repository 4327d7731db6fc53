"""What a model lacks: the quantities on which the error of its free run depends, and what was not determined.

A dependence is measured out of sample. First, what the model's force and a curve over the speed, times [1, current],
explain of the error is subtracted: a wrong gain or offset is no dependence. Then hat functions of a quantity multiply
these regressors; fitted on other blocks of time, they explain a share of the error's energy on each block. Errors whose
blocks have random signs (wild bootstrap; Cameron, Gelbach & Miller, Review of Economics and Statistics 90, 2008) show
which share chance explains for the best of all quantities: within a block, they are as correlated as the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from ces_data.arrays import F, I
from ces_identify.limits import LackLimits, MisfitLimits
from ces_identify.prepare.series import Series, changes
from ces_identify.simulations.simulate import simulate_series, since_reversal
from ces_identify.structures.kit import UNDETERMINED
from ces_identify.validation.band import PLAIN, band_state
from ces_identify.validation.evaluate import IDENTIFICATION, Evaluation, pooled_cost
from ces_observer.model import Model
from ces_report.typesetting import three_figures

FOLDS, DRAWS = 5, 99  # of blocks that are fitted on the others; of random signs
MAX_TICKS = 20_000  # evenly spaced
BLOCK_S, MIN_BLOCKS = 2.0, 14  # [s] far longer than the memory of a damper; blocks, for signs at random
HEAT_S = 100.0  # [s] in which oil warms up
RIDGE = 1e-2  # of the regressors' mean square
CURVE = 6  # hat functions of the speed
REGIONS = 5  # of a quantity, with as many ticks each
NETWORK = "hydraulic"
TRY_NETWORK = f"try --structure {NETWORK} ({{}}) or auto"
RECORD = "record more strokes of this kind, or try more --starts"


class Quantity(NamedTuple):
    """A quantity by its name in a sentence, its unit and the factor to it, its hat functions, and a remedy."""

    name: str
    unit: str
    factor: float
    hats: int
    remedy: str


QUANTITIES = {
    "position": Quantity("stroke", "mm", 1e3, 10, TRY_NETWORK.format("it knows a bypass over the stroke")),
    "speed": Quantity("speed", "m/s", 1.0, 10, "record more strokes at these speeds, or try --structure auto"),
    "current": Quantity("current", "A", 1.0, 6, "record more currents, and steps between them"),
    "direction": Quantity("direction of motion", "m/s", 1.0, 2, "check the tare of the force, or try --structure auto"),
    "acceleration": Quantity("acceleration", "m/s2", 1.0, 8, TRY_NETWORK.format("it knows oil and mount as springs")),
    "reversal": Quantity(
        "time since the last reversal", "ms", 1e3, 8, TRY_NETWORK.format("it knows friction and the stiffness of oil")
    ),
    "heat": Quantity("dissipated heat", "W", 1.0, 3, "record the damper as warm as in use, with rests"),
    "elapsed": Quantity(
        "time since the start", "s", 1.0, 3, "look for oil that warms up or a force sensor that drifts"
    ),
}


@dataclass(frozen=True)
class Dependence:
    """The error depends on the first of `names` (keys of QUANTITIES) or, as far as can be told, on another of them.

    It explains `share` of the error's energy; without that, J would be lower by `gain` [%]. `regions` are those of the
    first quantity, from, to (SI units), and the share by which the force exceeds the model's there.
    """

    names: tuple[str, ...]
    share: float
    gain: float
    regions: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class _Ticks:
    """Error and model force [N], and the quantities by name, at ticks (n,); the block and the fold of each."""

    error: F
    force: F
    quantities: dict[str, F]
    block: I
    fold: I


def head_lines(model: Model, evaluations: Sequence[Evaluation]) -> list[str]:
    """Return what a reader must know before the costs: no fit, currents or quantities that it lacks, open parameters.

    Recordings outside the envelope have warnings of their own and do not count.
    """
    some = [e for e in evaluations if np.isfinite(e.cost) and e.clamped_share < LackLimits.MAX_OUTSIDE]
    own = [e for e in some if e.role == IDENTIFICATION]
    causes = dependences(some)
    lines = [describe_gap(model)] * (model.used_gap_A is not None) + [describe(cause, model, some) for cause in causes]
    if own and (J := pooled_cost(own)) >= MisfitLimits.MISFIT_J:
        why = "" if causes else "; no quantity explains it: check units, signs and delays"
        lines.insert(0, f"The model does not fit its own data (J = {three_figures(J)} %){why}.")
    selections = [entry for key, entry in model.provenance.items() if key.startswith("selection")]
    texts = dict.fromkeys(text for entry in selections for text in entry.get(UNDETERMINED, ()))
    return lines + [f"{text[0].upper()}{text[1:].rstrip('.')}." for text in texts]


def describe_gap(model: Model) -> str:
    """Return that no currents were recorded in the gap of the envelope; '' without one."""
    if (gap := model.used_gap_A) is None:
        return ""
    ends = "{:.3g} and {:.3g} A".format(*gap)
    return f"No current between {ends} was recorded: forces there are interpolated, untested. Record currents there."


def describe(dependence: Dependence, model: Model, evaluations: Sequence[Evaluation]) -> str:
    """Return the dependence in words, with what to do about it."""
    quantity, option = QUANTITIES[dependence.names[0]], model.body.option
    names = " or ".join(f"the {QUANTITIES[name].name}" for name in dependence.names)
    which = " (these recordings do not tell which)" if len(dependence.names) > 1 else ""
    ends = sorted(dependence.regions, key=lambda region: region[2])
    named = [end for end in (ends[0], ends[-1]) if abs(end[2]) >= LackLimits.MIN_CHANGE]
    places = [_describe_region(dependence.names[0], *end) for end in named]
    where = f"; the magnitude of the force is {' and '.join(dict.fromkeys(places))}" if places else ""
    advice = RECORD if f"--structure {option}" in quantity.remedy else quantity.remedy
    if _is_unused(dependence.names[0], model, evaluations[0].series):
        advice = f"'{option}' as identified does not use it: {advice}"
    return (
        f"The error depends on {names}{which}: {100.0 * dependence.share:.0f} % of its energy, without which J would "
        f"be {three_figures(dependence.gain)} lower{where}. {advice[0].upper()}{advice[1:]}."
    )


def _describe_region(name: str, low: float, high: float, change: float) -> str:
    """Return what the force does in a region, such as `12 % below the model's from -5 to 5 mm`."""
    unit, factor = QUANTITIES[name].unit, QUANTITIES[name].factor
    first, last = (f"{float(f'{factor * end:.2g}') + 0.0:g}" for end in (low, high))
    where = f"at {first} {unit}" if low == high else f"from {first} to {last} {unit}"
    if name == "direction":
        where = "in compression" if low > 0.0 else "in rebound"
    return f"{100.0 * abs(change):.0f} % {'below' if change < 0.0 else 'above'} the model's {where}"


def _is_unused(name: str, model: Model, series: Series) -> bool:
    """Return whether the model's force does not depend on a quantity at all."""
    if name != "position":
        return name == "heat"
    still = replace(series, position=np.full(len(series), series.position.mean()))
    moving, frozen = (simulate_series(model, course).force for course in (series, still))
    return np.array_equal(moving, frozen, equal_nan=True)


def dependences(evaluations: Sequence[Evaluation]) -> list[Dependence]:
    """Return the quantities on which the errors of finite free runs depend, the one that explains most first."""
    if sum(int(e.series.scored.sum()) for e in evaluations) < LackLimits.MIN_TICKS:
        return []
    ticks, cost, listed = _collect(evaluations), pooled_cost(evaluations), list[Dependence]()
    unexplained = ticks.error
    while len(listed) < LackLimits.MAX_DEPENDENCES and unexplained.any():
        predicted, shares = _explain(unexplained, ticks)
        order = sorted(shares, key=lambda name: -shares[name][0])
        share = float(shares[order[0]][0]) if order else 0.0
        gain = cost * (1.0 - np.sqrt(max(0.0, 1.0 - share)))
        by_chance = max((float(draws[1:].max()) for draws in shares.values()), default=0.0)
        if share < LackLimits.MIN_SHARE or gain < LackLimits.MIN_GAIN or share <= by_chance:
            break
        first, names = order[0], tuple(name for name in order if shares[name][0] >= LackLimits.AS_GOOD * share)
        listed.append(Dependence(names, share, gain, _regions(ticks, ticks.quantities[first])))
        unexplained = unexplained - predicted[first]
    return listed


def _collect(evaluations: Sequence[Evaluation]) -> _Ticks:
    """Return at most MAX_TICKS scored ticks of all recordings, evenly spaced, with their blocks."""
    step = -(-sum(int(e.series.scored.sum()) for e in evaluations) // MAX_TICKS)
    length_s = min(BLOCK_S, sum(e.scored_s for e in evaluations) / MIN_BLOCKS)
    rows, blocks, folds, block = [], [], [], 0
    for e in evaluations:
        at, series = np.flatnonzero(e.series.scored)[::step], e.series
        halves = ((series.time_s[at] - series.time_s[at[0]]) / (0.5 * length_s)).astype(np.int64) + 2 * block
        block = int(halves[-1]) // 2 + 1
        blocks.append(halves // 2)
        folds.append(halves % FOLDS)
        rows.append(np.stack([series.force - e.run.force, e.run.force, *_quantities(e)])[:, at])
    error, force, *quantities = np.concatenate(rows, axis=1)
    by_name = dict(zip(QUANTITIES, quantities, strict=True))
    return _Ticks(error, force, by_name, np.concatenate(blocks), np.concatenate(folds))


def _quantities(e: Evaluation) -> list[F]:
    """Return QUANTITIES in their order, each (ticks,)."""
    position, speed, current, change, _ = band_state(PLAIN, e.series)
    power = np.abs(np.where(np.isfinite(e.series.force), e.series.force, e.run.force) * speed)
    decay = np.exp(-1.0 / (HEAT_S * e.series.rate_Hz))
    heat = lfilter([1.0 - decay], [1.0, -decay], np.nan_to_num(power))
    direction = np.where(speed < 0.0, -1.0, 1.0)
    return [
        position,
        speed,
        current,
        direction,
        change / PLAIN.change_s,
        since_reversal(e.series),
        heat,
        e.series.time_s,
    ]


def _regressors(ticks: _Ticks, curve: bool) -> F:
    """Return what the error may depend on in any case (n, m), each with a root mean square of 1.

    These are the force with a `curve` over the speed or, if it is the speed's own turn, with a line and its sign.
    """
    speed, current = ticks.quantities["speed"], ticks.quantities["current"]
    bent = np.tanh(speed / max(0.2 * float(speed.std()), 1e-9))
    rows = [ticks.force, *(_hats(speed, CURVE).T if curve else (np.ones(len(speed)), speed, bent))]
    if changes(current):
        rows += [row * (current - current.mean()) for row in rows]
    stacked = np.stack(rows, axis=1)
    return np.asarray(stacked / np.maximum(np.sqrt((stacked**2).mean(axis=0)), 1e-12))


def _hats(values: F, count: int) -> F:
    """Return hat functions of values (n,), shape (n, at most `count`)."""
    knots = np.unique(np.quantile(values, np.linspace(0.005, 0.995, count)))
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))], axis=1)


def _explain(error: F, ticks: _Ticks) -> tuple[dict[str, F], dict[str, F]]:
    """Return by quantity what it predicts of `error` (n,), and the shares of the energy at `ticks` that it explains.

    The shares (1 + DRAWS,) are that of the error and those with random signs.
    """
    draws = np.random.default_rng(0).choice([-1.0, 1.0], (int(ticks.block.max()) + 1, DRAWS))
    signs = np.column_stack([np.ones(len(error)), draws[ticks.block]])
    bases = {curve: _regressors(ticks, curve) for curve in (False, True)}
    rests = {curve: error - _predict(base, error[:, None], ticks.fold)[:, 0] for curve, base in bases.items()}
    predicted, shares = {}, {}
    for name, values in ticks.quantities.items():
        hats, curve = _hats(values, QUANTITIES[name].hats), name not in ("speed", "direction")
        if hats.shape[1] > 1:
            errors, base = rests[curve][:, None] * signs, bases[curve]
            guess = _predict((hats[:, :, None] * base[:, None, :]).reshape(len(error), -1), errors, ticks.fold)
            predicted[name] = guess[:, 0]
            shares[name] = ((errors**2).sum(axis=0) - ((errors - guess) ** 2).sum(axis=0)) / (ticks.error @ ticks.error)
    return predicted, shares


def _predict(regressors: F, errors: F, fold: I) -> F:
    """Return the prediction (n, m) of errors (n, m) on each fold by regressors (n, p) fitted on the other folds."""
    out, parts = np.zeros_like(errors), [fold == k for k in range(FOLDS)]
    grams = np.stack([regressors[part].T @ regressors[part] for part in parts])
    products = np.stack([regressors[part].T @ errors[part] for part in parts])
    for part, gram, product in zip(parts, grams.sum(axis=0) - grams, products.sum(axis=0) - products, strict=True):
        ridge = RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
        out[part] = regressors[part] @ np.linalg.solve(gram + ridge, product)
    return out


def _regions(ticks: _Ticks, values: F) -> tuple[tuple[float, float, float], ...]:
    """Return `Dependence.regions`: the levels of a quantity, or ranges with as many ticks each."""
    levels = np.unique(values)
    if len(levels) <= REGIONS:
        low, high, region = levels, levels, np.searchsorted(levels, values)
    else:
        edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, REGIONS + 1)))
        low, high, region = edges[:-1], edges[1:], np.searchsorted(edges[1:-1], values, "right")
    change = np.bincount(region, ticks.error * ticks.force) / np.maximum(np.bincount(region, ticks.force**2), 1e-12)
    return tuple(zip(low.tolist(), high.tolist(), change.tolist(), strict=True))
