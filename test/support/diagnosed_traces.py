"""A damper in memory with seal friction that its simulation lacks, on the diagnosis' grid, and where the gap lies."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ces_data.recording import Channel, Recording
from ces_gap.diagnosis import GapMap, GapRegion, HeldOutSeries, Where
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.trace import Trace, TraceInputs, make_trace

F = NDArray[np.float64]

NOISE_N = 8.0
COULOMB_N, TRANSITION = 38.0, 0.012  # [N], [m/s] of the withheld friction
EDGES = {
    "stroke_m": [-0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04],
    "speed_m_s": [-1.0, -0.3, -0.1, -0.03, 0.03, 0.1, 0.3, 1.0],
    "current_A": [0.0, 0.4, 0.8, 1.2, 1.6],
    "direction": [-1.0, 0.0, 1.0],
    "since_reversal_s": [0.0, 0.005, 0.01, 0.02, 0.05, 0.1, np.inf],
    "elapsed_s": [0.0, 2.5, 5.0, 7.5, 10.0],
    "heat_J": [0.0, 200.0, 400.0, 600.0, 800.0, np.inf],
}


class Friction(Effect):
    """Coulomb friction for tests."""

    name, form = "friction", "coulomb"
    parameters = (
        EffectParameter("coulomb_N", 0.0, 500.0, (20.0,), "friction force while sliding", magnitude=True),
        EffectParameter("transition_m_s", 1e-4, 0.1, (0.01,), "speed at which it is reached", scale="log"),
    )

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return force + values[0] * np.tanh(inputs.speed / values[1])


class ValveLag(Effect):
    """A valve lag for tests; only its name and parameters matter."""

    name, form = "valve_lag", "first order"
    parameters = (EffectParameter("rise_s", 0.0, 0.1, (0.01,), "time constant of a rising force", magnitude=True),)


class Hysteresis(Effect):
    """A magnetic hysteresis for tests; only its name and parameters matter."""

    name, form = "current_hysteresis", "play"
    parameters = (EffectParameter("width_A", 0.0, 0.5, (0.05,), "width of the play in the current", magnitude=True),)


def setting(effect: Effect, *values: float) -> Setting:
    return Setting(effect, values)


def series(
    name: str, seed: int, coulomb_N: float = COULOMB_N, own: float = 1.0, seconds: float = 10.0
) -> HeldOutSeries:
    """Return a recording with `coulomb_N` of friction that the simulation lacks, which is `own` times off itself."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 0.002)
    position = 0.02 * np.sin(2 * np.pi * 1.7 * time + seed) + 0.008 * np.sin(2 * np.pi * 5.1 * time)
    speed = np.gradient(position, time)
    current = np.repeat(rng.uniform(0.1, 1.5, len(time) // 250), 250)
    error = own * own_error(speed, current)
    simulated = damping(position, speed, current)
    force = simulated + error + coulomb_N * np.tanh(speed / TRANSITION) + NOISE_N * rng.normal(size=len(time))
    trace = make_trace(recording(name, time, position, current, force), simulated)
    corrected = trace.simulated + own * own_error(trace.inputs.speed, trace.inputs.current)
    effect = Composition((setting(Friction(), 0.97 * coulomb_N, 0.013),))
    return HeldOutSeries(trace, corrected, effect.respond(trace, trace.inputs, corrected))


def damping(position: F, speed: F, current: F) -> F:
    return np.asarray((500.0 + 700.0 * current) * np.tanh(speed / 0.12) + 450.0 * speed + 3000.0 * position)


def own_error(speed: F, current: F) -> F:
    return np.asarray(14.0 * np.sin(9.0 * speed) + 6.0 * current)


def recording(name: str, time: F, position: F, current: F, force: F) -> Recording:
    stamps = np.rint(time * 1e9).astype(np.int64)
    signals = {"position": ("m", position), "current": ("A", current), "force": ("N", force)}
    return Recording(name, {n: Channel(n, u, stamps, v) for n, (u, v) in signals.items()}, sha256="5a" * 32)


def located(held_out: Sequence[HeldOutSeries], kept: str = "simulated") -> Where:
    """Return where measured minus `kept` (simulated, corrected or augmented) lies, by plain binning."""
    gap = np.concatenate([(s.trace.force - _of(s, kept))[s.trace.usable] for s in held_out])
    values = {axis: np.concatenate([axis_values(s.trace)[axis][s.trace.usable] for s in held_out]) for axis in EDGES}
    square = np.maximum(gap**2 - NOISE_N**2, -(NOISE_N**2))
    found = [r for axis, edges in EDGES.items() for r in _regions(axis, np.array(edges), values[axis], square)]
    operating = max(found, key=lambda r: r.share_of_energy - r.share_of_samples)
    found += _spectrum(gap, np.concatenate([s.trace.force[s.trace.usable] for s in held_out]))
    ordered = tuple(sorted(found, key=lambda r: -r.share_of_energy))
    pairs = (("speed_m_s", "current_A"), ("stroke_m", "speed_m_s"))
    maps = tuple(_map(pair, values, square) for pair in pairs)
    return Where(ordered, operating, 0.0004, maps)


def axis_values(trace: Trace) -> dict[str, F]:
    """Return the coordinate of every tick on the axes of EDGES."""
    speed = trace.inputs.speed
    turned = np.maximum.accumulate(np.where(np.diff(np.sign(speed), prepend=0.0) != 0.0, trace.time_s, 0.0))
    return {
        "stroke_m": trace.inputs.position,
        "speed_m_s": speed,
        "current_A": trace.inputs.current,
        "direction": np.sign(speed) * 0.5,
        "since_reversal_s": trace.time_s - turned,
        "elapsed_s": trace.time_s,
        "heat_J": np.cumsum(trace.force * speed) * trace.step_s,
    }


def _of(s: HeldOutSeries, kept: str) -> F:
    return {"simulated": s.trace.simulated, "corrected": s.corrected, "augmented": s.augmented}[kept]


def _regions(axis: str, edges: F, values: F, square: F) -> list[GapRegion]:
    out = []
    for low, high in pairwise(edges):
        inside = (values >= low) & (values < high)
        share, samples = float(square[inside].sum() / square.sum()), float(inside.mean())
        rms = float(np.sqrt(max(square[inside].mean(), 0.0))) if inside.any() else 0.0
        q = 0.003 if share > 1.15 * samples else 0.6
        out.append(GapRegion(axis, low, high, share, samples, rms, (0.9 * rms, 1.12 * rms), q))
    return out


def _spectrum(gap: F, force: F) -> list[GapRegion]:
    frequency = np.fft.rfftfreq(len(gap), 0.002)
    power, of_force = (2.0 * np.abs(np.fft.rfft(v) / len(v)) ** 2 for v in (gap, force))
    power = np.maximum(power - np.median(power), 0.0)
    out = []
    for low, high in pairwise([0.0, 2.0, 5.0, 10.0, 20.0, 50.0, 250.0]):
        inside = (frequency >= low) & (frequency < high)
        energy, samples = float(power[inside].sum()), float(of_force[inside].sum() / of_force.sum())
        share, rms = energy / float(power.sum()), energy**0.5
        out.append(
            GapRegion(
                "frequency_hz",
                low,
                high,
                share,
                samples,
                rms,
                (0.9 * rms, 1.12 * rms),
                0.01 if share > samples else 1.0,
            )
        )
    return out


def _map(axes: tuple[str, str], values: dict[str, F], square: F) -> GapMap:
    x, y = (np.linspace(values[a].min(), values[a].max(), n + 1) for a, n in zip(axes, (24, 12), strict=True))
    count = np.histogram2d(values[axes[1]], values[axes[0]], bins=(y, x))[0]
    total = np.histogram2d(values[axes[1]], values[axes[0]], bins=(y, x), weights=square)[0]
    mean = np.where(count >= 8, total / np.maximum(count, 1.0), np.nan)
    return GapMap(axes, (x, y), np.sqrt(np.maximum(mean, 0.0)), count)
