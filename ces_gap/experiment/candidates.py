"""Candidate experiments that separate effects, and how near one effect comes to another on a trace.

A candidate, limited to about the operating range of the recordings, is a recipe that `ces rig FILE` runs. A signature
is the force that an effect adds to the plant, with derivatives by its parameters, which are scaled to the unit box (0
and 1 are the bounds on a search scale). Half the square of the whitened distance from A, at its fitted values, to B is
the expected log-likelihood ratio between A and B if A is true.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from ces_data.arrays import F
from ces_data.waveforms import currents, strokes
from ces_data.waveforms.strokes import Common, Stroke
from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.limits import ExperimentLimits
from ces_gap.trace import Trace, usable_inputs, usable_values

Recipe = dict[str, Any]

SEED = 1
FINE_S = 0.5e-3  # [s] the rig's grid
DECIMATION = 2  # to 1 kHz


@dataclass(frozen=True)
class Reach:
    """The limits of an experiment: a stroke of `centre_m` ± `amplitude_m`, speed, acceleration and current.

    The current cannot be commanded if `low_A` and `high_A` are equal.
    """

    centre_m: float
    amplitude_m: float
    speed_m_s: float
    acceleration_m_s2: float
    low_A: float
    high_A: float

    @property
    def middle_A(self) -> float:
        """The mean of lowest and highest current."""
        return _round((self.low_A + self.high_A) / 2.0)

    def top_Hz(self, speed_share: float) -> float:
        """Return the frequency at which a sine with this share of the speed uses all acceleration, up to 16 Hz."""
        return min(ExperimentLimits.MAX_HZ, self.acceleration_m_s2 / (2.0 * np.pi * speed_share * self.speed_m_s))


def reach_of(traces: Sequence[Trace]) -> Reach:
    """Return the limits of experiments: a little more than the range of the recordings."""
    x, v, i = (usable_inputs(traces, name) for name in ("position", "speed", "current"))
    a = usable_values(traces, [t.acceleration for t in traces])
    low, high = np.quantile(x, (0.001, 0.999))
    low_A, high_A = _currents(i, any("current" in t.recording.constants for t in traces))
    return Reach(
        centre_m=float(low + high) / 2.0,
        amplitude_m=max(ExperimentLimits.TRAVEL * float(high - low) / 2.0, ExperimentLimits.MIN_AMPLITUDE_M),
        speed_m_s=max(ExperimentLimits.SPEED * float(np.quantile(np.abs(v), 0.999)), ExperimentLimits.MIN_SPEED_M_S),
        acceleration_m_s2=max(
            ExperimentLimits.ACCELERATION * float(np.quantile(np.abs(a), 0.999)), ExperimentLimits.MIN_ACCELERATION_M_S2
        ),
        low_A=low_A,
        high_A=high_A,
    )


def list_candidate_experiments(reach: Reach) -> list[Recipe]:
    """Return recipes of 10 to 40 s within reach, with the keys that `ces rig` reads.

    Without a current to command, the experiments with a changing current are left out.
    """
    changing = _changing_current_experiments(reach) if reach.high_A > reach.low_A else []
    return [{**recipe, "seed": SEED} for recipe in (*_constant_current_experiments(reach), *changing)]


def _constant_current_experiments(r: Reach) -> list[Recipe]:
    soft, middle, hard = ({"kind": "constant", "current_A": level} for level in (r.low_A, r.middle_A, r.high_A))
    slow_Hz, fast_Hz = _sine_Hz(r, 0.6, 0.4), r.top_Hz(0.5)
    fast_m = _amplitude(r, 0.35, 0.5, fast_Hz)
    beat_Hz = _sine_Hz(r, 1.0, 0.8)
    beats_Hz = (beat_Hz, beat_Hz - min(0.16, 0.2 * beat_Hz))
    low_Hz = min(0.5, _sine_Hz(r, 0.9, 0.5))
    limits = {"amplitude_m": _round(0.9 * r.amplitude_m), "speed_m_s": _round(0.8 * r.speed_m_s)}
    sweep = _about(r, kind="sweep", from_Hz=_round(low_Hz), to_Hz=_round(max(r.top_Hz(0.8), 2.0 * low_Hz)), **limits)
    return [
        _recipe("slow_triangle", "slow motion to and fro: friction, gas and end stops without the valve", 40.0,
                _triangle(r, 1.0, 0.04), soft),
        _recipe("constant_speed", "constant speed to and fro at constant current", 20.0, _triangle(r, 0.9, 0.5), hard),
        _recipe("fast_reversals", "short strokes with reversals as sharp as in the recordings", 15.0,
                _triangle(r, 0.25, 0.9), middle),
        _recipe("two_frequency_sine", "a slow stroke with a fast one superimposed", 20.0,
                _sines(r, (0.6 * r.amplitude_m, fast_m), (slow_Hz, fast_Hz)), middle),
        _recipe("offset_dwell", "a small sine whose centre moves slowly from end to end", 30.0,
                _sines(r, (0.65 * r.amplitude_m, 0.3 * r.amplitude_m), (1.0 / 15.0, _sine_Hz(r, 0.3, 0.7))), middle),
        _recipe("amplitude_sweep", "two close frequencies: the amplitude rises and falls", 25.0,
                _sines(r, (0.5 * r.amplitude_m, 0.5 * r.amplitude_m), beats_Hz), middle),
        _recipe("frequency_sweep", "sine sweep at constant current", 30.0, sweep, middle),
        _recipe("hard_sine", "the largest speed at the highest current", 15.0, _sine(r, 0.9, 1.0), hard),
    ]  # fmt: skip


def _changing_current_experiments(r: Reach) -> list[Recipe]:
    steps = [r.low_A, r.high_A, r.middle_A, r.high_A, r.low_A, r.middle_A]
    levels = {"low_A": r.low_A, "high_A": r.high_A}
    return [
        _recipe("current_steps", "constant speed with steps of current", 20.0,
                _triangle(r, 0.9, 0.35), {"kind": "steps", "levels_A": steps, "hold_s": 0.37}),
        _recipe("current_prbs", "constant speed with a random binary current", 20.0,
                _triangle(r, 0.9, 0.35), {"kind": "prbs", **levels, "hold_s": 0.05}),
        _recipe("slow_current", "constant speed, current slowly up and down: hysteresis without lag", 40.0,
                _triangle(r, 0.9, 0.35), {"kind": "sine", **levels, "frequency_Hz": 0.05}),
        _recipe("fast_current", "constant speed, current quickly up and down: lag and hysteresis", 15.0,
                _triangle(r, 0.9, 0.35), {"kind": "sine", **levels, "frequency_Hz": 5.0}),
        _recipe("standstill_steps", "no motion, steps of current", 10.0,
                {"kind": "rest", "offset_m": _round(r.centre_m)}, {"kind": "steps", "levels_A": steps, "hold_s": 0.5}),
        _recipe("heat_soak", "hard and soft for 8 s each at high speed: separates heat from elapsed time", 40.0,
                _sine(r, 0.9, 0.8), {"kind": "steps", "levels_A": [r.high_A, r.low_A], "hold_s": 8.0}),
    ]  # fmt: skip


def _recipe(name: str, description: str, duration_s: float, stroke: Recipe, current: Recipe) -> Recipe:
    fields = {"name": name, "description": description, "duration_s": duration_s}
    return {**fields, "stroke": stroke, "current": current}


def _triangle(r: Reach, amplitude: float, speed: float) -> Recipe:
    """Return a triangle of these shares of the reach, with corners and speed limited by the acceleration."""
    amplitude_m = amplitude * r.amplitude_m
    speed_m_s = min(speed * r.speed_m_s, 0.5 * (r.acceleration_m_s2 * amplitude_m) ** 0.5)  # a corner is half a stroke
    corner = 4.0 * speed_m_s / r.acceleration_m_s2  # the peak of a raised cosine is twice its mean
    corner_s = _round(min(max(corner, 0.004), 1.0))
    return _about(r, kind="triangle", amplitude_m=_round(amplitude_m), speed_m_s=_round(speed_m_s), corner_s=corner_s)


def _sine(r: Reach, amplitude: float, speed: float) -> Recipe:
    frequency = _sine_Hz(r, amplitude, speed)
    amplitude_m = _amplitude(r, amplitude, speed, frequency)
    return _about(r, kind="sine", amplitude_m=_round(amplitude_m), frequency_Hz=_round(frequency))


def _sines(r: Reach, amplitudes_m: tuple[float, ...], frequencies_Hz: tuple[float, ...]) -> Recipe:
    amplitudes, frequencies = ([_round(v) for v in values] for values in (amplitudes_m, frequencies_Hz))
    return _about(r, kind="sum_of_sines", amplitudes_m=amplitudes, frequencies_Hz=frequencies)


def _about(r: Reach, **stroke: Any) -> Recipe:
    return {**stroke, "offset_m": _round(r.centre_m)}


def _sine_Hz(r: Reach, amplitude: float, speed: float) -> float:
    """Return the frequency of a sine with these shares of amplitude and speed, limited by the acceleration."""
    return min(speed * r.speed_m_s / (2.0 * np.pi * amplitude * r.amplitude_m), r.top_Hz(speed))


def _amplitude(r: Reach, amplitude: float, speed: float, frequency_Hz: float) -> float:
    """Return the largest amplitude [m] at a frequency within both shares."""
    return min(amplitude * r.amplitude_m, speed * r.speed_m_s / (2.0 * np.pi * frequency_Hz))


def _currents(current: F, fixed: bool) -> tuple[float, float]:
    """Return the lowest and highest current to command; both are the median if the current is fixed."""
    low, high = np.quantile(current, (0.005, 0.995))
    middle = float(np.median(current))
    if fixed or (abs(middle) < 1e-9 and high - low < 1e-9):
        return max(_round(middle), 0.0), max(_round(middle), 0.0)
    if high - low < ExperimentLimits.SAME_CURRENT * abs(middle):
        low, high = (1.0 - ExperimentLimits.CURRENT_CHANGE) * middle, (1.0 + ExperimentLimits.CURRENT_CHANGE) * middle
    return max(_round(float(low)), 0.0), max(_round(float(high)), 0.0)


def _round(value: float) -> float:
    """Return the value to three significant digits."""
    return float(f"{value:.3g}")


def generate_waveforms(recipe: Mapping[str, Any]) -> tuple[F, F, F]:
    """Return `time_s`, `position_m` and `current_A` (n,) at 1 kHz; raises KeyError for unknown kinds."""
    time = np.arange(round(recipe["duration_s"] / FINE_S) + 1) * FINE_S
    stroke, current = dict(recipe["stroke"]), dict(recipe["current"])
    offset, shape = Common(offset_m=stroke.pop("offset_m")), strokes.SINGLE[stroke.pop("kind")]
    position = Stroke(shape(**stroke), offset).samples(time, np.random.default_rng([recipe["seed"], 0]))
    level = currents.SINGLE[current.pop("kind")](**current)
    current_A = level.samples(time, position, np.random.default_rng([recipe["seed"], 1]))
    return time[::DECIMATION], position[::DECIMATION], current_A[::DECIMATION]


Whiten = Callable[[F], F]  # force [N] (n,) on a trace -> (m,) with noise of unit variance

STEP = 1e-3  # of a parameter's range: forward differences
FAN, RERUN_FAN = 2, 1  # points of a fan besides the fitted one; of effects that rerun the simulation
TRUST = 0.25  # of a parameter's range: how far shape parameters may move on a tangent
STEPS = 5  # of Gauss-Newton
GAIN = 0.995  # stop after a step that leaves more than this share of the distance


@dataclass(frozen=True)
class Tangent:
    """A whitened signature on a trace: `force` (m,), derivatives (m, p) = `q` (m, p) @ `r` (p, p).

    It touches the effect at `setting`.
    """

    setting: Setting
    force: F
    q: F
    r: F

    @property
    def size(self) -> float:
        """How visible the effect is: the norm of its whitened signature."""
        return float(np.linalg.norm(self.force))


@dataclass(frozen=True)
class Probe:
    """Computes signatures for `plant` on a `trace`; `whiten` must be linear."""

    plant: Plant
    trace: Trace
    whiten: Whiten

    def force(self, setting: Setting) -> F:
        """Return the force [N] (n,) that `setting` adds."""
        plant, alone = self._plant_and_force
        return np.asarray(plant.with_effects(Composition((setting,)), self.trace, alone) - alone)

    def tangent(self, setting: Setting) -> Tangent:
        """Return the tangent at `setting`; the simulation runs 1 + p times if the effect reruns it."""
        force, point, columns = self.force(setting), to_unit(setting), []
        for share, axis in zip(point, np.eye(len(point)), strict=True):
            step = STEP if share + STEP <= 1.0 else -STEP
            shifted = self.force(from_unit(setting.effect, point + step * axis))
            columns.append(self.whiten((shifted - force) / step))
        whitened = self.whiten(force)
        q, r = np.linalg.qr(np.array(columns).T.reshape(len(whitened), -1))
        return Tangent(setting, whitened, q, r)

    def size(self, setting: Setting) -> float:
        """Return the norm of the whitened signature."""
        return float(np.linalg.norm(self.whiten(self.force(setting))))

    @cached_property
    def _plant_and_force(self) -> tuple[Plant, F]:
        """The plant prepared for the trace, and its force alone [N] (n,)."""
        return self.plant.prepare_for(self.trace), self.plant.alone(self.trace)


def sample_tangents(probe: Probe, fitted: Tangent, size: float) -> list[Tangent]:
    """Return tangents of an effect at its fitted values and at a few of its starts.

    At the starts, magnitudes are scaled for a signature of norm `size`, that of the gap.
    """
    effect = fitted.setting.effect
    count = min(RERUN_FAN if effect.reruns else FAN, max((len(p.starts) for p in effect.parameters), default=0))
    starts = [Setting(effect, tuple(p.starts[k % len(p.starts)] for p in effect.parameters)) for k in range(count)]
    points = dict.fromkeys(_scale_setting(s, size / max(probe.size(s), 1e-9 * size)) for s in starts)
    return [fitted, *(probe.tangent(p) for p in points if p != fitted.setting)]


def to_unit(setting: Setting) -> F:
    """Return the values (p,) as shares of their search ranges."""
    pairs = list(zip(setting.effect.parameters, setting.values, strict=True))
    return np.array([(p.to_search(v) - p.search_bounds()[0]) / _width(p) for p, v in pairs])


def from_unit(effect: Effect, point: F) -> Setting:
    """Return the setting at the shares `point` (p,) of the search ranges; the inverse of `to_unit`."""
    pairs = zip(effect.parameters, point, strict=True)
    return Setting(effect, tuple(p.to_value(p.search_bounds()[0] + float(u) * _width(p)) for p, u in pairs))


def _width(parameter: EffectParameter) -> float:
    low, high = parameter.search_bounds()
    return max(high - low, 1e-300)


def _scale_setting(setting: Setting, factor: float) -> Setting:
    """Return the setting with the distances of its magnitudes from neutral scaled by `factor`, inside the bounds."""
    values = []
    for p, value in zip(setting.effect.parameters, setting.values, strict=True):
        inverse = p.scale == "inverse"
        scaled = value / max(factor, 1e-12) if inverse else p.neutral + factor * (value - p.neutral)
        values.append(float(min(max(scaled, p.low), p.high)) if p.magnitude else value)
    return Setting(setting.effect, tuple(values))


@dataclass(frozen=True)
class Match:
    """The nearest that B comes to A: at `setting` of B, ‖W(s_A − s_B)‖ is `index`."""

    setting: Setting
    index: float

    @property
    def evidence(self) -> float:
        """Expected log-likelihood ratio for A over B if A is true."""
        return self.index**2 / 2.0


def find_nearest(a: Tangent, fan_b: Sequence[Tangent]) -> Match:
    """Return how near B comes to A on B's tangents, inside its bounds, without a simulation."""
    return min((_match_on_tangent(a, b, TRUST) for b in fan_b), key=lambda match: match.index)


def refine_match(
    a: Tangent, fan_b: Sequence[Tangent], tangent: Callable[[Setting], Tangent], steps: int = STEPS
) -> Match:
    """Return how near B comes to A when B is evaluated: Gauss-Newton inside a trust region.

    The start is the nearest point according to the tangents, or the point of a tangent if that is nearer. `tangent`
    returns B's tangent at a setting. The true distance is at most the one returned.
    """
    best = min((tangent(find_nearest(a, fan_b).setting), *fan_b), key=lambda b: _whitened_distance(a, b))
    index, radius = _whitened_distance(a, best), TRUST
    for _ in range(steps):
        moved = tangent(_match_on_tangent(a, best, radius, free=False).setting)
        now = _whitened_distance(a, moved)
        if now >= index:
            radius /= 3.0
            continue
        converged, best, index, radius = now > GAIN * index, moved, now, 2.0 * radius
        if converged:
            break
    return Match(best.setting, index)


def _match_on_tangent(a: Tangent, b: Tangent, trust: float, free: bool = True) -> Match:
    """Return how near B's tangent comes to A: bounded linear least squares, shape parameters inside `trust`.

    With `free`, magnitudes may move over their whole range.
    """
    point, apart = to_unit(b.setting), a.force - b.force
    reach = np.array([1.0 if free and p.magnitude else trust for p in b.setting.effect.parameters])
    low, high = np.maximum(-point, -reach), np.minimum(1.0 - point, reach)
    move = _solve_bounded_step(b.r, b.q.T @ apart, low, high)
    index = float(np.linalg.norm(apart - b.q @ (b.r @ move)))
    return Match(from_unit(b.setting.effect, point + move), index)


def _solve_bounded_step(r: F, goal: F, low: F, high: F) -> F:
    """Return the move (p,) inside [low, high] that brings `r` @ move nearest to `goal`."""
    move: F = np.asarray(np.linalg.lstsq(r, goal, rcond=1e-9)[0], dtype=np.float64)
    if np.all((move >= low) & (move <= high)):
        return move
    movable = high - low > 1e-12
    bounded = np.zeros(len(low))
    if movable.any():
        bounded[movable] = lsq_linear(r[:, movable], goal, (low[movable], high[movable]), method="bvls").x
    return np.clip(bounded, low, high)


def _whitened_distance(a: Tangent, b: Tangent) -> float:
    return float(np.linalg.norm(a.force - b.force))
