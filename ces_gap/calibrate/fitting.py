"""The fit of named parameters to traces, and the evidence for effects beside them.

The low-pass that a diagnosis puts on the position would bias what depends on the speed; the noise of the logged one
would drown the rest in a simulation that differentiates without a filter. All parameters are fitted on both, and what
leaves less is taken. The estimate on the other shows how far a value depends on that; half of the difference is a part
of the interval.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ces_data.arrays import F
from ces_data.recording import Recording
from ces_gap.baseline.identified import add_own_error
from ces_gap.baseline.learner import NoiseModel, make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant, TraceSimulator
from ces_gap.baseline.wrappers import RememberedSimulation
from ces_gap.calibrate.parameters import (
    FreeParameters,
    SimulationParameters,
    choose_free,
    find_determined,
    interval_within,
    signatures,
    values_of,
    with_steps,
)
from ces_gap.effects.effect import Effect
from ces_gap.errors import GapError
from ces_gap.grid import rms
from ces_gap.inference.evidence import Evidence, gather, least_noise_N
from ces_gap.inference.fit import Z95, EffectFit, fit_to_the_end
from ces_gap.inputs.checks import exclude_saturated_ticks
from ces_gap.limits import EvidenceLimits, ParameterLimits
from ces_gap.trace import Trace, make_trace, own_error_N, require_usable, smooth_recording
from ces_identify.simulations.simulation import Simulation

SAME = 1e-9  # of the force: by as much two equal calls may differ
BIG = 1e3  # deviations by which the force may be off in a direction that the parameters fill


def open_logged(simulation: Simulation, recordings: Sequence[Recording]) -> list[Trace]:
    """Return the traces of recordings, on which the simulation runs on the logged position."""
    traces = [exclude_saturated_ticks(make_trace(r, simulation.force(r))) for r in recordings]
    traces = [add_own_error(simulation, t) for t in traces]
    for trace in traces:
        require_usable(trace)
    return traces


def smooth_traces(simulation: Simulation, traces: Sequence[Trace]) -> list[Trace]:
    """Return the traces with the smoothed position as that which was logged."""
    smooth = []
    for t in traces:
        recording = smooth_recording(t.recording, t)
        smooth.append(replace(make_trace(recording, simulation.force(recording), t.measured_noise), usable=t.usable))
    return smooth


def time_equal_calls(simulation: Simulation, real: Sequence[Recording], traces: Sequence[Trace], spec: str) -> float:
    """Return the seconds of a run over all recordings; raises GapError if it differs from the run before."""
    begun = time.monotonic()
    repeated = [make_trace(r, simulation.force(r), t.measured_noise) for r, t in zip(real, traces, strict=True)]
    seconds = time.monotonic() - begun
    for trace, second in zip(traces, repeated, strict=True):
        difference = rms((trace.simulated - second.simulated)[trace.usable])
        if difference > SAME * rms(trace.simulated[trace.usable]):
            raise GapError(
                f"{spec}: two equal calls on {trace.name} differ by {difference:.2g} N RMS, so it keeps a state or "
                "draws random numbers; expected a function of its arguments alone: begin each call anew"
            )
    return seconds


@dataclass(frozen=True)
class ParameterFit:
    """Parameters fitted to evidence, with the whole numbers that were set.

    `others` are the traces with the position that leaves more: the logged one if the fit `is_smoothed`.
    """

    evidence: Evidence
    effect: SimulationParameters  # of all that are free
    whole: Mapping[str, float]
    whole_defaults: Mapping[str, float]
    fit: EffectFit | None  # of those that are determined; None if there are none
    searched: F  # (p,) of all at the end
    jacobian: F  # (r, p) of all at the end
    determined: tuple[int, ...]
    twin: TraceSimulator | None = None
    is_smoothed: bool = False
    others: tuple[Trace, ...] = ()

    @property
    def units(self) -> Mapping[str, str]:
        """The unit of each parameter, empty where its name ends with it."""
        return {p.name: p.unit for p in self.effect.simulation.parameters}

    @property
    def start(self) -> F:
        """The defaults (p,) of all on their search scales."""
        return np.array([p.to_search(p.starts[0]) for p in self.effect.free])

    def beside_effect(self, effect: Effect | None, places: Sequence[int] | None = None) -> tuple[Effect, ...]:
        """Return the parameters at some places, by default those that are determined, and the effect beside them."""
        places = self.determined if places is None else places
        inside = effect is not None and effect.edits
        own = (replace(self.effect.hold_others(places), adds=inside),) if len(places) else ()
        return own if effect is None else (*own, effect)

    @property
    def default_residual(self) -> F:
        """The whitened residual (r,) at the defaults."""
        return self.evidence.residual(self.evidence.alone)

    @property
    def gap_energy(self) -> float:
        """Whitened energy of the gap at the defaults, above the noise's."""
        residual = self.default_residual
        return max(float(residual @ residual) - len(residual), EvidenceLimits.MIN_GAP_ENERGY * len(residual))

    @property
    def cost(self) -> float:
        """Whitened sum of squares, cross-fitted."""
        return float(self.default_residual @ self.default_residual) if self.fit is None else self.fit.cost

    def beside(self, places: Sequence[int], searched: F) -> Evidence:
        """Return the evidence with parameters at searched values, without the directions that they fill."""
        effect = self.effect.hold_others(places)
        fitted = self.effect.simulation.with_values(values_of(effect, searched))
        traces = [replace(t, simulated=DirectSimulator(fitted).force(t, t.inputs)) for t in self.evidence.traces]
        features = signatures(effect, searched, traces)
        size = np.linalg.norm(np.concatenate(features), axis=0) / self.evidence.noise.rms_N
        covariance = np.diag((BIG / np.maximum(size, 1e-300)) ** 2)
        plant = Plant(DirectSimulator(fitted), twin=self.twin)
        return gather(traces, plant, self.evidence.noise, features, covariance)


def unexplained_N(traces: Sequence[Trace]) -> float:
    """Return the RMS [N] that no parameter explains: a gap of `EvidenceLimits.VISIBLE` times as much is none.

    It is noise, and of an identified model the limit of its own error.
    """
    return math.hypot(least_noise_N(traces), own_error_N(traces) / EvidenceLimits.VISIBLE)


def fit_parameters(
    simulation: Simulation,
    free: FreeParameters,
    logged: Sequence[Trace],
    whole: Mapping[str, float],
    twin: TraceSimulator | None = None,
) -> ParameterFit:
    """Return the fit on the `logged` or on the smoothed position, whichever leaves less.

    `whole` numbers are set first. Effects inside the damper will be put into its `twin`.
    """
    smooth, noise = smooth_traces(simulation, logged), make_white_noise(unexplained_N(logged))
    on_logged, on_smooth = (_fit_on(simulation, free, traces, whole, twin, noise) for traces in (logged, smooth))
    if on_logged.cost <= on_smooth.cost:
        return replace(on_logged, others=tuple(smooth))
    return replace(on_smooth, others=tuple(logged), is_smoothed=True)


def _fit_on(
    simulation: Simulation,
    free: FreeParameters,
    traces: Sequence[Trace],
    whole: Mapping[str, float],
    twin: TraceSimulator | None,
    noise: NoiseModel,
) -> ParameterFit:
    """Return the fit of all numbers that the traces determine, judged at the defaults and again at the end."""
    whole_defaults = {p.name: p.default for p in simulation.parameters if p.name in whole}
    if whole:
        simulation = simulation.with_values(whole)
        traces = [replace(t, simulated=DirectSimulator(simulation).force(t, t.inputs)) for t in traces]
    evidence = gather(traces, Plant(DirectSimulator(simulation), twin=twin), noise)
    effect = with_steps(SimulationParameters(simulation, free.numbers), traces, evidence.noise.rms_N)
    at = np.array([p.to_search(p.starts[0]) for p in effect.free])
    jacobian = evidence.whiten(signatures(effect, at, evidence.traces))
    fit, determined = None, tuple[int, ...]()
    for _ in range(2):
        now_determined = tuple(find_determined(jacobian, effect.free))
        if now_determined == determined:
            break
        determined = now_determined
        start, held = at[list(determined)], effect.hold_others(determined)
        fit = fit_to_the_end(evidence, (held,), start) if determined else None
        at = np.array([p.to_search(p.starts[0]) for p in effect.free])
        at[list(determined)] = fit.searched if fit else []
        jacobian = evidence.whiten(signatures(effect, at, evidence.traces))
    return ParameterFit(evidence, effect, whole, whole_defaults, fit, at, jacobian, determined, twin)


def find_loose(fitted: ParameterFit, places: Sequence[int], fit: EffectFit) -> list[int]:
    """Return the positions in `places` of the parameters that a fit does not tell from their defaults nor limits."""
    errors, loose = Z95 * np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)), []
    for position, (k, u, error) in enumerate(zip(places, fit.searched.tolist(), errors.tolist(), strict=False)):
        p = fitted.effect.free[k]
        low, high = interval_within(p, u, error)
        if low <= p.starts[0] <= high and not (math.isfinite(low) and math.isfinite(high)):
            loose.append(position)
    return loose


def fit_on_others(fitted: ParameterFit, fit: EffectFit) -> F:
    """Return the searched values (q,) of a fit on the other position."""
    simulator = DirectSimulator(fitted.effect.simulation)
    traces = [replace(t, simulated=simulator.force(t, t.inputs)) for t in fitted.others]
    evidence = gather(traces, Plant(simulator, twin=fitted.twin), fitted.evidence.noise)
    return fit_to_the_end(evidence, fit.effects, fit.searched).searched


def changed_parameters(
    simulation: Simulation, spec: str, evidence: Evidence, fit: Sequence[str]
) -> list[SimulationParameters]:
    """Return the forms of the effect that parameters named by `fit` have changed; none if nothing is determined."""
    free = choose_free(simulation, fit, spec).numbers
    whole = SimulationParameters(RememberedSimulation(simulation), free, adds=True)
    whole = with_steps(whole, evidence.traces, evidence.noise.rms_N)
    start = np.array([p.to_search(p.starts[0]) for p in free])
    jacobian = evidence.whiten(signatures(whole, start, evidence.traces))
    residual, determined = evidence.residual(evidence.alone), find_determined(jacobian, free)
    forms = []
    count = len(determined)
    for size in {*range(1, min(ParameterLimits.MAX_FREED, count) + 1), *([count] if count else [])}:
        steps = {places: _step(jacobian[:, places], residual) for places in combinations(determined, size)}
        best = max(steps, key=lambda places: float(steps[places] @ jacobian[:, places].T @ residual))
        forms.append(whole.hold_others(best).begin_at(start[list(best)] + steps[best]))
    return forms


def _step(jacobian: F, residual: F) -> F:
    """Return the Gauss-Newton step (p,) that explains a residual (r,)."""
    return np.asarray(np.linalg.lstsq(jacobian, residual, rcond=1e-9)[0])
