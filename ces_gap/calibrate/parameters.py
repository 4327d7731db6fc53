"""The parameters of a simulation: which are fitted within which range, and all of them as one effect.

The effect is force + f(θ) - f(default) at the driven inputs. So parameters are fitted, cross-validated and combined
with missing effects by the same functions as those. `--fit NAME[=LOW..HIGH]` chooses parameters and bounds.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.sparse.csgraph import connected_components

from ces_data.arrays import F
from ces_gap.baseline.plant import DirectSimulator
from ces_gap.effects.effect import SIMULATION, Composition, Effect, EffectParameter
from ces_gap.errors import GapError
from ces_gap.grid import rms
from ces_gap.inference.judgement import PARAMETERS
from ces_gap.limits import EvidenceLimits, ParameterLimits, SearchLimits
from ces_gap.trace import Trace, TraceInputs, resample_to_grid, usable_values
from ces_identify.simulations.simulation import Parameter, Simulation
from ces_observer.errors import CesError, OptionName

FIRST_STEP, MIN_STEP, MAX_STEP = 0.02, 1e-4, 0.25  # of a parameter's size, by which it is changed for a derivative


@dataclass(frozen=True)
class SimulationParameters(Effect):
    """Some parameters of a simulation; those that are not `free` keep their defaults."""

    simulation: Simulation = field(hash=False)
    free: tuple[EffectParameter, ...]
    adds: bool = False  # to a force that holds more than the simulation's: a correction, or an effect in its twin
    begin: tuple[float, ...] = ()  # of a search, besides the defaults

    name, form, stage = PARAMETERS, "values", SIMULATION
    summary = "numbers of the simulation are off"

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:  # type: ignore[override]
        """The free parameters, their defaults as starts."""
        return self.free

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        """Return `force` [N] (n,) and what the values change of the simulation's; NaN where it does not run."""
        changed = self.simulation.with_values(dict(zip([p.name for p in self.free], values, strict=True)))
        try:
            own = _simulate(changed, trace, inputs)
            if not self.adds:  # then `force` is that of the defaults
                return own
            if inputs is trace.inputs:
                return np.asarray(force + own - trace.simulated)
            return np.asarray(force + own - DirectSimulator(self.simulation).force(trace, inputs))
        except CesError:
            return np.full(len(trace), np.nan)

    def starts_for(self, trace: Trace) -> list[tuple[float, ...]]:
        """Return where a search begins."""
        return [self.begin] if self.begin else super().starts_for(trace)

    def begin_at(self, searched: F) -> SimulationParameters:
        """Return the effect with a search from these values (p,) on the search scales."""
        return replace(self, begin=tuple(p.to_value(u) for p, u in zip(self.free, searched.tolist(), strict=True)))

    def hold_others(self, places: Sequence[int]) -> SimulationParameters:
        """Return the effect of the parameters at some places; the others keep their defaults."""
        return replace(self, free=tuple(self.free[k] for k in places))


def _simulate(simulation: Simulation, trace: Trace, inputs: TraceInputs) -> F:
    """Return the force [N] (n,) on the grid; recorded inputs are those of the recording."""
    if inputs is trace.inputs:
        return resample_to_grid(trace, simulation.force(trace.recording))
    return DirectSimulator(simulation).force(trace, inputs)


def size_of(p: EffectParameter) -> float:
    """Return the size of a parameter on its search scale: a factor of e, or its default, or half its range."""
    if p.scale == "log":
        return 1.0
    return abs(p.starts[0]) or 0.5 * (p.high - p.low)


def interval_within(p: EffectParameter, searched: float, error: float) -> tuple[float, float]:
    """Return the interval of a value, `error` to each side on the search scale; endless where it leaves the range.

    The error is taken to the value linearly, as the force follows most parameters. The range is a guess, so an end of
    it is none of the interval (a profile that no bound closes, Raue et al. 2009), unless it is the default: no leak is
    the least of all leaks.
    """
    value, default = p.to_value(searched), p.starts[0]
    half = error * (value if p.scale == "log" else 1.0)
    low, high = max(value - half, p.low), min(value + half, p.high)
    (first, last), near = p.search_bounds(), SearchLimits.NEAR_BOUND * np.subtract(*p.search_bounds()[::-1])
    return (
        low if p.to_search(low) > first + near or p.low == default else -math.inf,
        high if p.to_search(high) < last - near or p.high == default else math.inf,
    )


def with_steps(effect: SimulationParameters, traces: Sequence[Trace], noise_N: float) -> SimulationParameters:
    """Return the effect with a step for the derivative by each parameter that moves the force by about the noise."""
    simulated = usable_values(traces, [t.simulated for t in traces])

    def step(k: int) -> float:
        searched = np.array([p.to_search(p.starts[0]) for p in effect.free])
        p, size = effect.free[k], size_of(effect.free[k])
        room = p.search_bounds()[1] - searched[k]
        first = FIRST_STEP * size * (1.0 if room > FIRST_STEP * size else -1.0)
        searched[k] += first
        values = [q.to_value(u) for q, u in zip(effect.free, searched.tolist(), strict=True)]
        moved = usable_values(traces, [effect.respond(t, t.inputs, t.simulated, values) for t in traces])
        change = rms(moved - simulated)
        wanted = FIRST_STEP * noise_N / change if change > 0.0 else MAX_STEP
        return float(np.clip(wanted if np.isfinite(wanted) else FIRST_STEP, MIN_STEP, MAX_STEP)) * size

    return replace(effect, free=tuple(replace(p, step=step(k)) for k, p in enumerate(effect.free)))


def signatures(effect: SimulationParameters, at: F, traces: Sequence[Trace]) -> list[F]:
    """Return the derivative of the force (n, p) [N] by each searched value, at values (p,), on each trace."""

    def forces(searched: F) -> list[F]:
        values = [p.to_value(u) for p, u in zip(effect.free, searched.tolist(), strict=True)]
        return [effect.respond(t, t.inputs, t.simulated, values) for t in traces]

    base, columns = forces(at), []
    for k, p in enumerate(effect.free):
        step = p.step if at[k] + p.step <= p.search_bounds()[1] else -p.step
        moved = forces(at + step * (np.arange(len(at)) == k))
        if not all(np.isfinite(force).all() for force in moved):  # the simulation fails there
            step *= -1.0
            moved = forces(at + step * (np.arange(len(at)) == k))
        columns.append([np.nan_to_num((new - old) / step) for new, old in zip(moved, base, strict=True)])
    return [np.column_stack(column) for column in zip(*columns, strict=True)] or [np.zeros((len(t), 0)) for t in traces]


def find_determined(jacobian: F, parameters: Sequence[EffectParameter]) -> list[int]:
    """Return which columns of a whitened Jacobian (r, p), on search scales, the data determine beside each other.

    The pivots of a QR decomposition (Golub and Van Loan, section 5.4) say by how much a change of each parameter's
    size moves the force where the others are refitted.
    """
    if not len(parameters):
        return []
    sized = jacobian * np.array([size_of(p) for p in parameters])
    pivots, order = qr(sized, mode="r", pivoting=True)
    clear = np.abs(np.diag(pivots)) > EvidenceLimits.SURE
    return sorted(order[: len(clear)][clear].tolist())


def find_groups(jacobian: F, covariance: F, determined: Sequence[int], names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return which parameters move together: one not determined with those that make up for it, and correlated ones."""
    groups = []
    columns = jacobian[:, list(determined)]
    for k in sorted({*range(len(names))} - {*determined}):
        if not (size := float(np.linalg.norm(jacobian[:, k]))) or not len(determined):
            continue
        weights = np.linalg.lstsq(columns, jacobian[:, k], rcond=1e-9)[0] * np.linalg.norm(columns, axis=0)
        least = ParameterLimits.MAX_SHARED * size
        near = [names[j] for j, w in zip(determined, weights.tolist(), strict=True) if abs(w) > least]
        groups += [(names[k], *near)] if near else []
    return groups + _find_correlated(covariance, [names[k] for k in determined])


def _find_correlated(covariance: F, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the parameters whose estimates are correlated, with all that they are correlated with in one group."""
    if not len(names):
        return []
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    close: NDArray[np.bool_] = np.abs(covariance / np.outer(size, size)) > ParameterLimits.MAX_CORRELATION
    count, group = connected_components(close, directed=False)
    groups = [tuple(name for name, own in zip(names, group, strict=True) if own == k) for k in range(count)]
    return [names for names in groups if len(names) > 1]


def values_of(effect: SimulationParameters, searched: F) -> dict[str, float]:
    """Return the value of each free parameter from the search scale; `searched` may go on with those of an effect."""
    return {p.name: p.to_value(u) for p, u in zip(effect.free, searched.tolist(), strict=False)}


def parameter_values(composition: Composition) -> dict[str, float]:
    """Return the values of the simulation's parameters in a composition."""
    own = [s for s in composition.settings if s.name == PARAMETERS]
    return {p.name: value for s in own for p, value in zip(s.effect.parameters, s.values, strict=True)}


NONE = "none"  # as the only word of --fit: all parameters stay as they are
WORD = re.compile(r"([^=]+)(?:=(.+)\.\.(.+))?")


@dataclass(frozen=True)
class FreeParameters:
    """What is fitted: `numbers` continuously, `whole` ones by trying each value; `notes` say why others are not."""

    numbers: tuple[EffectParameter, ...]
    whole: Mapping[str, tuple[int, ...]]
    notes: tuple[str, ...] = ()

    @property
    def trials(self) -> list[dict[str, float]]:
        """Every combination of the whole numbers; one without any if there are none."""
        return [dict(zip(self.whole, map(float, values), strict=True)) for values in product(*self.whole.values())]


def choose_free(simulation: Simulation, words: Sequence[str], spec: str) -> FreeParameters:
    """Return the parameters that `words` (NAME or NAME=LOW..HIGH) name, all that can be fitted if there are none.

    Raises GapError for an unknown name, a range that is none, and a default that gives no range.
    """
    declared = {p.name: p for p in simulation.parameters}
    if list(words) == [NONE]:
        return FreeParameters((), {})
    ranges = dict(map(_read_word, words))
    for name in ranges:
        if name not in declared:
            has = f"it has {', '.join(declared)}" if declared else "it declares none by keyword-only arguments"
            raise GapError(OptionName("fit", name), f": {spec} has no such parameter; {has}")
    chosen = [p for p in declared.values() if not ranges or p.name in ranges]
    skipped = {p.name: _why_not(p) for p in chosen if ranges.get(p.name) is None and _why_not(p)}
    if ranges and skipped:
        name, why = next(iter(skipped.items()))
        raise GapError(OptionName("fit", name), f": {why}")
    whole = {p.name: _whole_values(p, ranges[p.name]) for p in chosen if p.whole and p.name not in skipped}
    free = FreeParameters(
        tuple(_as_searched(p, ranges.get(p.name)) for p in chosen if not p.whole and p.name not in skipped),
        whole,
        tuple(f"{name} is not fitted: {why}" for name, why in skipped.items()),
    )
    if len(free.trials) > ParameterLimits.MAX_TRIALS:
        count, most = len(free.trials), ParameterLimits.MAX_TRIALS
        raise GapError(OptionName("fit"), f": {count} combinations of whole numbers; expected at most {most}")
    return free


def _read_word(word: str) -> tuple[str, tuple[float, float] | None]:
    match = WORD.fullmatch(word)
    try:
        if match is None:
            raise ValueError
        if match[2] is None:
            return match[1], None
        low, high = float(match[2]), float(match[3])
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError
    except ValueError:
        expected = ": expected NAME or NAME=LOW..HIGH, as knee_m_s=0.05..0.3"
        raise GapError(OptionName("fit", word), expected) from None
    return match[1], (low, high)


def _why_not(p: Parameter) -> str:
    """Return why a parameter cannot be fitted without a range, empty if it can."""
    if p.whole:
        return f"it is a whole number ({p.default:g}); give {p.name}=LOW..HIGH to try each, or write {p.default:g}.0"
    if p.default == 0.0 and not (math.isfinite(p.low) and math.isfinite(p.high)):
        return f"its default of 0 gives no range; give {p.name}=LOW..HIGH"
    return ""


def _whole_values(p: Parameter, ends: tuple[float, float] | None) -> tuple[int, ...]:
    low, high = ends or (p.low, p.high)
    return tuple(range(math.ceil(low), math.floor(high) + 1))


def _as_searched(p: Parameter, ends: tuple[float, float] | None) -> EffectParameter:
    """Return the parameter with its scale and bounds: logarithmic where all of them are positive."""
    around = sorted((p.default / ParameterLimits.RANGE_FACTOR, p.default * ParameterLimits.RANGE_FACTOR))
    low, high = ends or (max(p.low, around[0]), min(p.high, around[1]))
    if not ends and p.default == 0.0:
        low, high = p.low, p.high
    start = min(max(p.default, low), high)
    if not low < high or start != p.default:
        given = OptionName("fit", f"{p.name}={low:g}..{high:g}")
        raise GapError(given, f": expected a range around its default of {p.default:g}")
    return EffectParameter(p.name, low, high, (start,), f"default {p.default:.4g}", "log" if low > 0.0 else "linear")
