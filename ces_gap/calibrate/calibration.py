"""The named parameters of a simulation fitted to recordings: values with intervals, the gap, and what is missing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ces_data.reading import import_pandas
from ces_data.recording import Recording
from ces_gap.baseline.plant import DirectSimulator, Plant, TraceSimulator
from ces_gap.baseline.wrappers import RememberedSimulation
from ces_gap.calibrate.choice import ChosenExplanation, Hypothesis, choose
from ces_gap.calibrate.fitting import (
    ParameterFit,
    fit_on_others,
    fit_parameters,
    open_logged,
    smooth_traces,
    time_equal_calls,
)
from ces_gap.calibrate.parameters import FreeParameters, choose_free, find_groups, interval_within
from ces_gap.effects.effect import Effect, Setting
from ces_gap.effects.library import library
from ces_gap.errors import GapError
from ces_gap.inference.fit import Z95, EffectFit, Estimate, estimate_parameters
from ces_gap.inference.held_out import HeldOutSeries
from ces_gap.inputs.prepare import set_aside
from ces_gap.limits import ParameterLimits, SearchLimits
from ces_gap.progress import Progress, ignore_progress
from ces_gap.trace import Trace, gap_N, noise_floor_N
from ces_identify.simulations.simulation import Simulation
from ces_report.table import PrintedResult, summarize_result

RUNS = 50  # for each parameter and one more, measured: about as often a fit with the choice runs the simulation
DECLARED = (
    "functions declare them by keyword-only arguments with defaults (*, seal_N=25.0); of models, hydraulic ones do"
)
HELD = "the calibrated values are kept; name those that may have changed since with --fit"
WORSE = "the fitted values explain held-out recordings no better than the defaults, which are kept"


@dataclass(frozen=True)
class FittedParameter:
    """A parameter's value with its 95 % interval beside its default.

    The interval is endless where it leaves the range of the search, and of a parameter that keeps its default because
    it is not determined. Its `unit` is empty where the name ends with it. It `matters` if it is a part of the best
    explanation of the gap.
    """

    name: str
    value: float
    ci95: tuple[float, float]
    default: float
    at_bound: bool = False
    unit: str = ""
    matters: bool = False

    @property
    def determined(self) -> bool:
        """Whether the recordings limit it on both sides."""
        return all(map(math.isfinite, self.ci95))

    @property
    def is_doubtful(self) -> bool:
        """Whether it is at its bound, or far from its default."""
        ratio, most = self.value / self.default if self.default else 1.0, ParameterLimits.DOUBTFUL
        return self.at_bound or not 1.0 / most <= ratio <= most

    @property
    def is_beside(self) -> bool:
        """Whether its fitted value is surely another than its default, though it is no part of the best explanation."""
        return not self.matters and not self.ci95[0] <= self.default <= self.ci95[1]


@dataclass(frozen=True, repr=False)
class MissingEffect:
    """The effect that explains most beside the parameters, its estimates, and the gap [N] left with both.

    Where the defaults are kept, as the fitted values without the effect leave more (`alone_N`), these are `beside` it.
    """

    setting: Setting
    estimates: tuple[Estimate, ...]
    gap_after_N: float
    beside: tuple[FittedParameter, ...] = ()
    alone_N: float = math.nan

    def __repr__(self) -> str:
        numbers = ", ".join(f"{e.name} {e.value:.3g}" for e in self.estimates)
        return f"<{self.setting.name}: {numbers}; with it {self.gap_after_N:.3g} N are left>"


@dataclass(frozen=True)
class Alternative:
    """What would explain the gap as well: other values of some parameters, which `freed` holds, an effect, or both."""

    parameters: tuple[FittedParameter, ...]
    effect: Setting | None
    freed: Setting | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters and of the effect."""
        return (*(p.name for p in self.parameters), *([] if self.effect is None else [self.effect.name]))

    @property
    def only(self) -> Setting | None:
        """Its only setting; None if it has both."""
        return None if self.effect and self.freed else self.effect or self.freed


@dataclass(frozen=True, repr=False)
class Calibration(PrintedResult):
    """What a fit of parameters found; gaps [N] are on held-out recordings, with the noise subtracted.

    `simulation` has the values of `parameters`, the defaults where fitted ones leave no less, and leaves `after_N`;
    `moves_with` are groups of parameters whose changes look alike.
    """

    spec: str
    simulation: Simulation
    parameters: tuple[FittedParameter, ...]
    moves_with: tuple[tuple[str, ...], ...]
    before_N: float
    after_N: float
    noise_N: float
    missing: MissingEffect | None = None
    alternatives: tuple[Alternative, ...] = ()
    notes: tuple[str, ...] = ()
    is_smoothed: bool = False  # whether the smoothed position was better than the logged one
    held_out: tuple[HeldOutSeries, ...] = ()  # with the force before and after

    @property
    def sentence(self) -> str:
        """What was found."""
        return summarize_result(self)[0][0]

    @property
    def values(self) -> dict[str, float]:
        """The value of each parameter by its name."""
        return {parameter.name: parameter.value for parameter in self.parameters}

    def to_frame(self) -> Any:
        """Return the parameters as a DataFrame with their 95 % intervals; endless for one that is not determined."""
        rows = [
            {
                "parameter": p.name,
                "unit": p.unit,
                "default": p.default,
                "value": p.value,
                "low": p.ci95[0],
                "high": p.ci95[1],
                "determined": p.determined,
                "at_bound": p.at_bound,
                "matters": p.matters,
            }
            for p in self.parameters
        ]
        return import_pandas().DataFrame(rows)


def calibrate(
    simulation: Simulation,
    spec: str,
    real: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    fit: Sequence[str] = (),
    progress: Progress = ignore_progress,
) -> Calibration:
    """Return the fitted parameters of `simulation`, named `spec`; `fit` names some of them (NAME or NAME=LOW..HIGH).

    Without `held_out` a part of `real` is set aside. Raises CesError if nothing can be fitted.
    """
    free = choose_free(simulation, fit, spec)
    if not free.numbers and not free.whole:
        why = "; ".join(free.notes) or DECLARED
        raise GapError(f"{spec}: no parameter to fit: {why}")
    progress("simulating", 0.0)
    fitted = open_logged(simulation, real)
    seconds = time_equal_calls(simulation, real, fitted, spec)
    simulation = RememberedSimulation(simulation)
    held = open_logged(simulation, held_out)
    if not held:
        fitted, held = set_aside(fitted)
    told = tell_time(len(free.trials) * RUNS * (len(free.numbers) + 1), seconds)
    results = []
    for k, whole in enumerate(free.trials):
        progress(f"fitting{told}", k / len(free.trials))
        results.append(fit_parameters(simulation, free, fitted, whole))
    best = min(results, key=lambda result: result.cost)
    effects = _list_affordable(library(), None, seconds)
    if seconds > ParameterLimits.SLOW_S:
        free = replace(
            free, notes=(*free.notes, "effects that run the slow simulation again were not tried beside them")
        )
    return _assemble(spec, free, best, choose(best, effects, progress), held)


@dataclass(frozen=True)
class FreedParameters:
    """What parameters explain of a gap: those that are `freed`, the effect beside them, and what does as well.

    `simulation` has their values, `setting` holds them for a composition (None if none is freed). They `competed` with
    the effects unless there are none. `pairs` are explanations of one setting each that an experiment may separate.
    """

    simulation: Simulation
    freed: tuple[FittedParameter, ...] = ()
    setting: Setting | None = None
    effect: str = ""
    alternatives: tuple[Alternative, ...] = ()
    notes: tuple[str, ...] = ()
    competed: bool = False
    pairs: tuple[tuple[Setting, Setting], ...] = ()


def free_parameters(
    simulation: Simulation,
    spec: str,
    real: Sequence[Recording],
    has_held_out: bool,
    effects: Sequence[Effect],
    twin: TraceSimulator | None,
    fit: Sequence[str] = (),
    progress: Progress = ignore_progress,
) -> FreedParameters:
    """Return what the parameters of `simulation` explain of its gap to `real`, beside the effects and instead of them.

    Without held-out recordings a part of `real` is not used. Whole numbers keep their values, and so do those of a
    calibrated simulation unless `fit` names some.
    """
    if not fit and getattr(simulation, "values", None):
        return FreedParameters(simulation, notes=(HELD,))
    free = choose_free(simulation, fit, spec)
    if not free.numbers:
        return FreedParameters(simulation, notes=free.notes)
    progress("fitting the simulation's parameters", 0.0)
    traces = open_logged(simulation, real)
    seconds = time_equal_calls(simulation, real, traces, spec)
    runs = RUNS * (len(free.numbers) + 1)
    if not fit and runs * seconds > ParameterLimits.MAX_UNASKED_S:
        how = "name those that may be off with --fit, or run `ces calibrate`"
        note = f"the parameters keep their values: to fit them takes{tell_time(runs, seconds).strip(':')}; {how}"
        return FreedParameters(simulation, notes=(*free.notes, note))
    progress(f"fitting the simulation's parameters{tell_time(runs, seconds)}", 0.0)
    remembered, traces = RememberedSimulation(simulation), traces if has_held_out else set_aside(traces)[0]
    fitted = fit_parameters(remembered, free, traces, {}, twin)
    choice = choose(fitted, _list_affordable(effects, twin, seconds), progress)
    best, *others = (_as_alternative(fitted, h) for h in (choice.best, *choice.alternatives))
    changed = simulation.with_values({p.name: p.value for p in best.parameters})
    return FreedParameters(
        simulation=changed,
        freed=best.parameters,
        setting=best.freed,
        effect=best.effect.name if best.effect else "",
        alternatives=tuple(others),
        notes=free.notes,
        competed=True,
        pairs=tuple((best.only, other.only) for other in others if best.only and other.only),
    )


def _list_affordable(effects: Sequence[Effect], twin: TraceSimulator | None, seconds: float) -> list[Effect]:
    """Return the effects that are tried: those inside with a twin only, none that runs a slow simulation again."""
    is_slow = seconds > ParameterLimits.SLOW_S
    return [e for e in effects if not (e.edits and twin is None) and not (e.reruns and is_slow)]


def tell_time(runs: int, seconds: float) -> str:
    """Return how long `runs` of the simulation take, `seconds` each; empty if that is not worth a word."""
    if runs * seconds < ParameterLimits.MIN_TOLD_S:
        return ""
    return f": about {runs} runs of {seconds:.2g} s, {runs * seconds / 60.0:.0f} min"


def _assemble(
    spec: str, free: FreeParameters, best: ParameterFit, choice: ChosenExplanation, held: Sequence[Trace]
) -> Calibration:
    """Return the result; under a missing effect, the parameters are those of the joint fit, unless alone they are
    worse than the defaults.
    """
    whole, simulation = choice.whole, best.effect.simulation
    held = smooth_traces(simulation, held) if best.is_smoothed else held
    joint = None if choice.best.effect is None else whole.fit
    parameters, calibrated = (*_list_whole(best), *_list_numbers(best, choice)), simulation
    noise_N, before_N = noise_floor_N(held), gap_N(held, [t.simulated for t in held], noise_floor_N(held))
    changed = simulation.with_values({p.name: p.value for p in parameters})
    forces = [DirectSimulator(changed).force(t, t.inputs) for t in held]
    after_N, notes = gap_N(held, forces, noise_N), free.notes
    missing = None if joint is None else _describe_missing(joint, simulation, held, noise_N)
    if after_N < before_N:
        calibrated = changed
    else:
        notes = notes if before_N <= noise_N or missing else (*notes, WORSE)
        if missing and any(p.value != p.default for p in parameters):
            missing = replace(missing, beside=parameters, alone_N=after_N)
        forces, after_N = [t.simulated for t in held], before_N
        parameters = tuple(map(_keep_default, parameters))
    count = len(whole.places)
    covariance = np.zeros((0, 0)) if whole.fit is None else whole.fit.covariance[:count, :count]
    groups = find_groups(best.jacobian, covariance, whole.places, [p.name for p in best.effect.free])
    alternatives = tuple(_as_alternative(best, h) for h in choice.alternatives)
    series = tuple(HeldOutSeries(t, t.simulated, force) for t, force in zip(held, forces, strict=True))
    if isinstance(calibrated, RememberedSimulation):
        calibrated = calibrated.with_own_values
    facts = tuple(groups), before_N, after_N, noise_N, missing, alternatives, notes, best.is_smoothed, series
    return Calibration(spec, calibrated, parameters, *facts)


def _keep_default(p: FittedParameter) -> FittedParameter:
    ends = p.ci95 if p.ci95[0] <= p.default <= p.ci95[1] else (-math.inf, math.inf)
    return replace(p, value=p.default, ci95=ends, at_bound=False, matters=False)


def _as_alternative(fitted: ParameterFit, h: Hypothesis) -> Alternative:
    settings = () if h.fit is None else h.fit.composition.settings
    effect = settings[-1] if settings and h.effect is not None else None
    return Alternative(tuple(estimate(fitted, h)), effect, settings[0] if settings and h.places else None)


def _list_whole(best: ParameterFit) -> list[FittedParameter]:
    """Return the whole numbers at the values that fit best."""
    defaults = best.whole_defaults
    return [FittedParameter(n, v, (v, v), defaults[n], matters=v != defaults[n]) for n, v in best.whole.items()]


def _list_numbers(best: ParameterFit, choice: ChosenExplanation) -> list[FittedParameter]:
    """Return the fitted parameters with their intervals, and those that keep their defaults."""
    freed = {best.effect.free[k].name for k in choice.best.places}
    rows = {p.name: replace(p, matters=p.name in freed) for p in estimate(best, choice.whole)}
    unknown, units = (-math.inf, math.inf), best.units
    return [
        rows.get(p.name) or FittedParameter(p.name, p.starts[0], unknown, p.starts[0], unit=units[p.name])
        for p in best.effect.free
    ]


def estimate(found: ParameterFit, h: Hypothesis) -> list[FittedParameter]:
    """Return the parameters of a hypothesis; each interval is widened by what the other position changes."""
    if h.fit is None or not h.places:
        return []
    count, units = len(h.places), found.units
    bias = 0.5 * np.abs(fit_on_others(found, h.fit) - h.fit.searched)[:count]
    errors = Z95 * np.sqrt(np.maximum(np.diag(h.fit.covariance)[:count], 0.0)) + bias
    fitted = []
    for k, u, error in zip(h.places, h.fit.searched.tolist(), errors.tolist(), strict=False):
        p = found.effect.free[k]
        (low, high), start, ends = p.search_bounds(), p.to_search(p.starts[0]), interval_within(p, u, error)
        near = SearchLimits.NEAR_BOUND * (high - low)
        stuck = (u - low < near or high - u < near) and abs(u - start) > near
        fitted.append(FittedParameter(p.name, p.to_value(u), ends, p.starts[0], stuck, units[p.name]))
    return fitted


def _describe_missing(joint: EffectFit, simulation: Simulation, held: Sequence[Trace], noise_N: float) -> MissingEffect:
    plant, composition = Plant(DirectSimulator(simulation)), joint.composition
    forces, setting = [plant.with_effects(composition, t) for t in held], composition.settings[-1]
    return MissingEffect(setting, estimate_parameters(joint)[-1], gap_N(held, forces, noise_N))
