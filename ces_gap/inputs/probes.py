"""What a simulation does to its inputs: short synthetic strokes and steps of current in; lead, delay and noise out.

No recording is needed to know whether a simulation interpolates the current where the real one is held, or filters the
position: it is asked, at the strokes, speeds and currents of a recording. What is found is undone before effects are
searched for (`RetimedSimulation`), if the recordings agree.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F, Mask
from ces_data.recording import Channel, Recording
from ces_gap.baseline.plant import DirectSimulator
from ces_gap.baseline.wrappers import MAX_DELAY_S, ON_TIME, InputTiming, RetimedSimulation
from ces_gap.grid import derivative, is_constant, rms
from ces_gap.inputs.probe_result import EARLY, HELD, INTERPOLATED, LATE, NOT_PROBED, STATIC, SimulationProbe
from ces_gap.limits import EvidenceLimits, ProbeLimits, SearchLimits
from ces_gap.progress import OptionalSteps
from ces_gap.trace import Trace, usable_values
from ces_identify.simulations.simulation import ModelSimulation, Simulation, find_predictions

HALF_STROKE_S = 0.35  # [s] each at constant speed
CORNER_S = 0.02  # [s] in which the speed changes its sign
SETTLED = 0.4  # of a half-stroke: what came before the corner has settled
STEP_AT = 0.55  # of a half-stroke: a step of the current
AFTER_STEP = 0.36  # of a half-stroke in which the answer is watched, up to the corner
SLOWER = 0.4  # of the higher speed: the other one
TONES_HZ = np.array([12.0, 21.0, 33.0, 50.0, 65.0, 85.0, 110.0, 145.0, 190.0, 250.0])
LOW_TONES = 4  # as many show the lag of force behind speed
MAX_TONE = 0.25  # of the sample rate: above it differences of samples are no speed
TONE_SHARE = 0.02  # of the speed: the speed of each small cosine
FAST = 4  # as many half-strokes at the higher speed, where the valve is open, then as many at the other
MIN_NOISE = 1e-6  # of the force's RMS: rounding
MIN_TICKS = 10  # of a half-stroke, that show whether a force is rough
LEFT_OPEN = 0.1  # of a delay: how far the recordings may choose another one


@dataclass(frozen=True)
class _Run:
    """A synthetic recording: stroke [m] and current [A] (n,) every `step_s`, half-stroke after half-stroke."""

    step_s: float
    stroke: F
    current: F

    @property
    def time_s(self) -> F:
        return np.asarray(np.arange(len(self.stroke)) * self.step_s)

    def with_stroke(self, added: F) -> _Run:
        return replace(self, stroke=self.stroke + added)


Runner = Callable[[_Run], F]  # a synthetic recording -> the force [N] (n,) of the simulation


@dataclass(frozen=True)
class _Range:
    """Operating points from a recording: centre of the stroke [m], speed [m/s], two currents [A], sample interval."""

    centre_m: float
    speed_m_s: float
    current_A: tuple[float, float]
    step_s: float


def probe(simulation: Simulation, trace: Trace) -> SimulationProbe:
    """Return what the simulation does to its inputs, within the stroke, speed and current of the trace's recording.

    It costs five runs of 1 to 3 s. A simulation that refuses them, or that was only recorded, gives a `note`.
    """
    if find_predictions(simulation) is not None:
        return SimulationProbe(note="recorded predictions cannot be probed: they cannot be run with other inputs")
    start, runs = time.monotonic(), []

    def force(run: _Run) -> F:
        runs.append(run)
        return _run(simulation, trace.recording, run)

    steps = OptionalSteps()
    result = steps.run("probe of the simulation", lambda: _ask(force, _find_range(trace)), NOT_PROBED)
    result = replace(result, note="; ".join(steps.notes)) if steps.notes else result
    return replace(result, calls=len(runs), seconds=time.monotonic() - start)


def correct_inputs(
    simulation: Simulation, traces: Sequence[Trace], references: Sequence[Trace]
) -> tuple[SimulationProbe, Simulation]:
    """Return the probe, and the simulation with the timing of its inputs corrected as far as the recordings agree.

    A delay that the probe cannot tell from a soft damper's lag is not undone. References decide if there are any. A
    model that was identified has learnt the timing of its inputs: it is not corrected. Nor is what does not bring the
    simulation closer: the real current may be smooth instead of held.
    """
    result = probe(simulation, traces[0])
    if isinstance(simulation.innermost, ModelSimulation):
        return replace(result, is_learnt=True), simulation
    if not result.timing:
        return result, simulation
    judges, (low_s, high_s), best = references or traces, result.position_delay_s, ON_TIME
    measured = usable_values(judges, [t.force for t in judges])

    def left(timing: InputTiming) -> float:
        direct = DirectSimulator(RetimedSimulation(simulation, timing))
        forces = [direct.force(t, t.inputs) if timing else t.simulated for t in judges]
        return rms(measured - usable_values(judges, forces)) ** 2

    def better(timing: InputTiming) -> InputTiming:
        return timing if left(timing) < (1.0 - SearchLimits.MIN_FORM_GAIN) * left(best) else best

    if lead := result.timing.current_lead_samples:
        best = better(InputTiming(lead))
    if low_s > 0.0 and high_s < ProbeLimits.MAX_OPEN * low_s:  # the recordings choose within what the probe leaves open
        delays = np.linspace((1.0 - LEFT_OPEN) * low_s, min((1.0 + LEFT_OPEN) * high_s, MAX_DELAY_S), 3)
        curve = np.polyfit(delays, [left(replace(best, position_delay_s=float(d))) for d in delays], 2)
        vertex = -0.5 * curve[1] / curve[0] if curve[0] > 0.0 else delays[int(np.argmin(np.polyval(curve, delays)))]
        best = better(replace(best, position_delay_s=float(np.clip(vertex, delays[0], delays[-1]))))
    return replace(result, corrected=best), RetimedSimulation(simulation, best) if best else simulation


def _run(simulation: Simulation, like: Recording, run: _Run) -> F:
    """Return the force [N] (n,) on a synthetic recording with the channels of a real one."""
    stamps = like.channel("position").stamps_ns[0] + np.round(run.time_s * 1e9).astype(np.int64)
    speed = derivative(run.stroke, 1.0 / run.step_s)
    moved = {"speed": speed, "acceleration": derivative(speed, 1.0 / run.step_s)}
    signals = {"position": run.stroke, "current": run.current}
    signals |= {name: values for name, values in moved.items() if name in like.channels}
    units = {"current": "A"} | {n: c.unit for n, c in like.channels.items()}
    channels = {name: Channel(name, units[name], stamps, values) for name, values in signals.items()}
    constants = {name: value for name, value in like.constants.items() if name not in channels}
    return simulation.force(Recording("probe", channels, constants))


def _find_range(trace: Trace) -> _Range:
    """Return the operating points of a trace."""
    stroke, speed, current = (getattr(trace.inputs, n)[trace.usable] for n in ("position", "speed", "current"))
    low_m, high_m = np.percentile(stroke, [2.0, 98.0])
    highest = min(float(np.percentile(np.abs(speed), 90.0)), 0.8 * float(high_m - low_m) / HALF_STROKE_S)
    low_A, high_A = np.percentile(current, [5.0, 95.0])
    if is_constant(current, 1e-3):
        low_A = high_A = np.median(current)
    step_s = float(trace.base_grid[1][1])
    return _Range(0.5 * float(low_m + high_m), highest, (float(low_A), float(high_A)), step_s)


def _move(at: _Range, speeds: Sequence[float], levels: Sequence[float], jump: float = 0.0, finer: int = 1) -> _Run:
    """Return half-strokes out and in at the `speeds`, each with a level [A] that begins at its share `jump`.

    `finer` is the number of samples in place of one of the recording.
    """
    count, step_s = len(speeds), at.step_s / finer
    seconds = np.arange(finer * round(count * HALF_STROKE_S / at.step_s) + 1) * step_s
    number = np.minimum((seconds / HALF_STROKE_S).astype(np.int64), count - 1)
    phase = seconds - number * HALF_STROKE_S
    corner = np.sin(0.5 * np.pi * np.clip(np.minimum(phase, HALF_STROKE_S - phase) / CORNER_S, 0.0, 1.0))
    speed = np.array(speeds)[number] * np.where(number % 2 == 0, 1.0, -1.0) * corner
    stroke = np.concatenate([[0.0], np.cumsum(0.5 * step_s * (speed[1:] + speed[:-1]))])
    begun = number + (phase >= jump * HALF_STROKE_S - 1e-9) - 1  # the level before the first jump is the last one
    return _Run(step_s, at.centre_m - 0.5 * HALF_STROKE_S * max(speeds) + stroke, np.array(levels)[begun])


def _ask(run: Runner, at: _Range) -> SimulationProbe:
    (low_A, high_A), fast, slow = at.current_A, at.speed_m_s, SLOWER * at.speed_m_s
    if not fast > ProbeLimits.MIN_SPEED_M_S or at.step_s > ProbeLimits.MAX_STEP_S:
        why = "hardly moves" if at.step_s <= ProbeLimits.MAX_STEP_S else f"has a position every {at.step_s:.2g} s only"
        return SimulationProbe(note=f"the simulation was not probed: the recording {why}")
    base = _move(at, [fast] * FAST + [slow] * FAST, [low_A, low_A, high_A, high_A] * 2)
    tones = TONES_HZ[TONES_HZ * at.step_s <= MAX_TONE]
    phases = np.pi * np.arange(len(tones)) ** 2 / max(len(tones), 1)
    speed = TONE_SHARE * np.where(base.time_s < FAST * HALF_STROKE_S, fast, slow)
    waves = np.cos(2.0 * np.pi * np.outer(base.time_s, tones) + phases) / (2.0 * np.pi * tones)
    added = speed * waves.sum(axis=1)
    plus, minus, repeated = (run(base.with_stroke(sign * added)) for sign in (1.0, -1.0, 1.0))
    finite = np.isfinite(plus) & np.isfinite(minus) & np.isfinite(repeated)
    size_N = rms(plus[finite]) if finite.any() else 0.0
    noise_N, memory_N = _compare_calls(repeated[finite] - plus[finite], size_N)
    result, answer = SimulationProbe(sample_s=at.step_s, noise_N=noise_N, memory_N=memory_N), 0.5 * (plus - minus)
    if len(tones) >= LOW_TONES and size_N > 0.0 and np.ptp(answer[finite]) > MIN_NOISE * size_N:
        points, is_fast = _find_damping(answer, added, tones, at.step_s)
        if len(points):
            ticks = (1.0 - SETTLED) * HALF_STROKE_S / at.step_s
            scatter = 2.0 * noise_N / math.sqrt(ticks) / (TONE_SHARE * slow)  # of the damping [N s/m]
            result = _find_filter(result, points, is_fast, tones, scatter)
    if high_A > low_A:
        result = _find_lead(result, run, at, ProbeLimits.MIN_ANSWER * size_N)
    rough_N = _measure_roughness(0.5 * (plus + minus), at.step_s)
    return replace(result, noise_N=max(noise_N, rough_N if rough_N > ProbeLimits.MIN_ROUGHNESS * size_N else 0.0))


def _parts(values: F, step_s: float) -> Iterator[Mask]:
    """Yield the known ticks (n,) of each half-stroke after what came before its corner has settled."""
    seconds = np.arange(len(values)) * step_s
    for number in range(2 * FAST):
        begin, end = (number + SETTLED) * HALF_STROKE_S, (number + 1) * HALF_STROKE_S - 1.5 * CORNER_S
        yield (seconds >= begin) & (seconds <= end) & np.isfinite(values)


def _measure_roughness(force: F, step_s: float) -> float:
    """Return the RMS [N] of white noise on a force (n,) that should be smooth, from its third differences."""
    jumps = [np.diff(force[part], 3) for part in _parts(force, step_s) if part.sum() > MIN_TICKS]
    return float(np.median(np.abs(np.concatenate(jumps)))) / 0.6745 / math.sqrt(20.0) if jumps else 0.0


def _compare_calls(difference: F, size_N: float) -> tuple[float, float]:
    """Return the noise and the memory [N] that the difference of two equal calls shows; another was in between."""
    if len(difference) < 2 or rms(difference) <= MIN_NOISE * size_N:
        return 0.0, 0.0
    is_white = abs(float(difference[1:] @ difference[:-1])) < ProbeLimits.WHITE * float(difference @ difference)
    return (rms(difference) / math.sqrt(2.0), 0.0) if is_white else (0.0, rms(difference))


def _find_damping(answer: F, added: F, tones: F, step_s: float) -> tuple[NDArray[np.complex128], Mask]:
    """Return the force over speed [N s/m] (points, tones), and which points (points,) are at the higher speed.

    `answer` [N] (n,) is that to the `added` stroke [m]; each half-stroke that is answered is an operating point.
    """
    seconds, damping, is_fast = np.asarray(np.arange(len(answer)) * step_s), [], []
    for number, part in enumerate(_parts(answer, step_s)):
        if part.sum() < 3 * len(tones):
            continue
        force, stroke = (_demodulate(values[part], seconds[part], tones) for values in (answer, added))
        if force.all():
            damping.append(force / (2j * np.pi * tones * stroke))
            is_fast.append(number < FAST)
    return np.array(damping), np.array(is_fast, dtype=bool)


def _find_filter(
    result: SimulationProbe, damping: NDArray[np.complex128], is_fast: Mask, tones: F, scatter: float
) -> SimulationProbe:
    """Return the probe with the delay of a filter on the position; `damping` (points, tones) has a `scatter`.

    A filter's lag is there at every operating point. That of a soft damper, its damping over a stiffness, grows
    with the damping: extrapolated to none, it vanishes.
    """
    w, phase, size = 2.0 * np.pi * tones, np.unwrap(np.angle(damping), axis=1), np.abs(damping[:, 0])
    low = w[:LOW_TONES]
    fitted = np.linalg.pinv(np.stack([low, low**3, 1.0 / low], axis=1))[0]  # the lag at the frequencies of strokes
    lag = -phase[:, :LOW_TONES] @ fitted  # without that of a spring in parallel, such as gas, over frequency
    error_s = EvidenceLimits.SURE * scatter / max(float(size.min()), 1e-9) * float(np.linalg.norm(fitted))
    undamped = _extrapolate(lag[is_fast], size[is_fast]) or _extrapolate(lag, size)
    highest = max(float(lag.min()), 0.0)
    certain = min(float(np.median(undamped)) if undamped else 0.0, highest)
    if not undamped and (phase.min(axis=1) < -ProbeLimits.ACTIVE_RAD).all():
        certain = highest
    is_found = certain - error_s > max(ProbeLimits.MIN_SHIFT_SAMPLES * result.sample_s, ProbeLimits.MIN_DELAY_S)
    return replace(result, position_delay_s=(certain if is_found else 0.0, highest + error_s))


def _extrapolate(lag: F, size: F) -> list[float]:
    """Return the lag [s] (n,) at no damping, from each pair of points whose damping `size` (n,) [N s/m] differs."""
    points = range(len(lag))
    low, high = ProbeLimits.MIN_DAMPING_RATIO, ProbeLimits.MAX_DAMPING_RATIO
    pairs = [(i, j) for i in points for j in points if low < size[j] / size[i] < high]
    return [float(lag[i] - (lag[j] - lag[i]) / (size[j] / size[i] - 1.0)) for i, j in pairs]


def _demodulate(values: F, seconds: F, tones: F) -> NDArray[np.complex128]:
    """Return the complex amplitude of each tone, all fitted at once under a window."""
    angle, window = 2.0 * np.pi * np.outer(seconds, tones), np.hanning(len(seconds))
    columns = np.concatenate([np.cos(angle), np.sin(angle), np.ones((len(seconds), 1))], axis=1)
    weights = np.linalg.lstsq(columns * window[:, None], values * window, rcond=None)[0]
    return np.asarray(weights[: len(tones)] - 1j * weights[len(tones) : 2 * len(tones)])


def _find_lead(result: SimulationProbe, run: Runner, at: _Range, least_N: float) -> SimulationProbe:
    """Return the probe with how the simulation takes steps of current, from the same steps at two sample intervals.

    Interpolation leads by a share of the interval, a valve's own lag is the same at both: the area between the answers,
    over the size of the step, is the difference of the leads.
    """
    (low_A, high_A), speeds = at.current_A, [at.speed_m_s] * FAST
    coarse, fine = (_move(at, speeds, [high_A, low_A] * 2, STEP_AT, finer) for finer in (1, 2))
    fine = replace(fine, current=np.repeat(coarse.current, 2)[: len(fine.stroke)])
    force, finer_force = run(coarse), run(fine)[::2]
    before, after = (round(share * HALF_STROKE_S / at.step_s) for share in (STEP_AT - SETTLED, AFTER_STEP))
    area = sizes = own = 0.0
    ticks = 0
    for step in np.flatnonzero(np.diff(coarse.current)) + 1:
        part, number = slice(step - before, step + after), np.arange(-before, after)
        if not np.isfinite(force[part] - finer_force[part]).all():
            continue
        earlier = number < -1
        answer = force[part] - np.polyval(np.polyfit(number[earlier], force[part][earlier], 1), number)
        apart = (force - finer_force)[part] - float((force - finer_force)[part][earlier].mean())
        size = float(answer[-(len(answer) // 4) :].mean())
        sign = math.copysign(1.0, size)
        area, sizes, own = area + sign * float(apart.sum()), sizes + abs(size), own + sign * float(answer[before])
        ticks += len(answer)
    error = EvidenceLimits.SURE * 2.0 * result.noise_N * math.sqrt(2.0 * ticks) / max(sizes, 1e-9)
    if sizes <= FAST * least_N or error > ProbeLimits.MIN_SHIFT_SAMPLES:
        return result
    lead = 2.0 * area / sizes
    how = EARLY if lead > 0.0 else LATE
    if abs(lead) < ProbeLimits.MIN_SHIFT_SAMPLES:
        how = STATIC if own / sizes > 0.9 else HELD  # the answer in the step's own sample
    elif abs(lead - 0.5) < 0.2:
        how = INTERPOLATED
    return replace(result, current_lead_samples=lead, current_convention=how)
