"""Sound recordings that judge the sense checks: dampers, strokes, currents, mounts and loggers drawn anew.

No threshold is set with them in view. `JUDGING` and `DEVELOPING` draw from streams of their own; only the second is
looked at while checks are written. Sizes run from a small motorcycle's damper to a lorry's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.random import Generator
from scipy.signal import butter, sosfiltfilt

from ces_data.arrays import F
from ces_data.recording import Channel, Recording
from ces_data.waveforms.currents import Binary, ConstantLevel, FilteredNoise, SineCurrent, Steps, StrokeFollowing
from ces_data.waveforms.sequences import Current
from ces_data.waveforms.strokes import FrequencyModulated, NoiseStroke, RoadStroke, Sine, SumOfSines, Sweep, Triangle
from ces_rig.dampers.effects import EFFECTS
from ces_rig.dampers.model import DamperModel
from ces_rig.sensors import GRID_S, Sensor, Sensors, measure_signals
from ces_rig.withheld.plants import PLANTS, available_effects, draw_effect, draw_plant, simulate_signals

JUDGING, DEVELOPING = 2, 1  # streams of random numbers
SECONDS, ACTUATOR_HZ, REACH_M = 16.0, 35.0, (0.020, 0.045)
MAX_SPEED_M_S, MAX_RMS_M_S = 3.0, 1.0  # of the recorded position: a wheel on a kerb, a race
FAULTY = ("position_delay", "force_scale")  # effects that are faults of a recording themselves
MAX_EFFECTS = 3
SIZES = {"motorcycle": (0.3, 0.8), "car": (1.0, 1.0), "lorry": (5.0, 2.0)}  # force and stroke of the drawn damper
Stroke = Callable[[F, Generator], F]


def draw_judges(stream: int, plants: int = 1) -> Iterator[Recording]:
    """Yield `plants` recordings for each stroke and each kind of damper; equal streams give equal recordings."""
    for number, (name, (stroke, current)) in enumerate(RIDES.items()):
        for index, kind in enumerate(PLANTS):
            for repeat in range(plants):
                rng = np.random.default_rng([stream, number, index, repeat])
                plant = draw_plant(kind, rng)
                yield _record(f"{name} {kind} {repeat}", plant, stroke, current(plant.current_A, rng), rng)


def _record(name: str, plant: DamperModel, stroke: Stroke, current: Current, rng: Generator) -> Recording:
    time: F = np.arange(round(SECONDS / GRID_S) + 1, dtype=np.float64) * GRID_S
    moved: F = sosfiltfilt(butter(4, ACTUATOR_HZ, fs=1.0 / GRID_S, output="sos"), stroke(time, rng))
    size, leverage = tuple(SIZES)[int(rng.integers(len(SIZES)))], float(rng.choice([1.0, rng.uniform(0.45, 0.95)]))
    moved *= rng.uniform(*REACH_M) / float(np.abs(moved).max())
    speed = np.gradient(moved, GRID_S) * SIZES[size][1] / leverage
    moved *= min(1.0, MAX_SPEED_M_S / float(np.abs(speed).max()), MAX_RMS_M_S / float(np.sqrt(np.mean(speed**2))))
    command = current.samples(time, moved, rng)
    names = [n for n in available_effects(plant.kind) if n in EFFECTS and n not in FAULTY]
    drawn = rng.choice(names, int(rng.integers(MAX_EFFECTS + 1)), replace=False)
    effects = [replace(draw_effect(plant.kind, str(n), rng), severity=rng.uniform(0.2, 1.0)) for n in drawn]
    true = simulate_signals(plant, effects, time, moved, command)
    sensors = _draw_sensors(float(np.abs(true.force_N).max()), rng)
    return _resize(measure_signals(true, sensors, int(rng.integers(2**31)), f"{name} {size}"), size, leverage)


def _draw_sensors(force_N: float, rng: Generator) -> Sensors:
    rate = float(rng.choice([500.0, 1000.0, 1000.0, 2000.0]))
    return Sensors(
        position=Sensor(noise=10.0 ** rng.uniform(-5.5, -4.3), quantum=10.0 ** rng.uniform(-6, -4.6), rate_Hz=rate),
        current=Sensor(noise=1e-3, quantum=1e-3, rate_Hz=float(rng.choice([100.0, 500.0, rate])), phase_s=0.2e-3),
        force=Sensor(
            noise=force_N * 10.0 ** rng.uniform(-3.3, -2.0),
            quantum=force_N * 10.0 ** rng.uniform(-4.3, -2.7),
            bias=force_N * rng.uniform(-0.1, 0.1),
            rate_Hz=float(rng.choice([rate, 500.0])),
            phase_s=rng.uniform(0.0, 1e-3),
            jitter_s=10.0 ** rng.uniform(-6, -3.7),
            dropout=float(rng.choice([0.0, 0.01])),
        ),
        current_source=str(rng.choice(["measured", "commanded"])),
    )


def _resize(recording: Recording, size: str, leverage: float) -> Recording:
    """Return the recording of a damper of another size, whose stroke is measured over a leverage that bends a little.

    `leverage` is the piston's stroke over the sensor's: a sensor at the wheel moves more.
    """
    force, stroke = SIZES[size]

    def change(channel: Channel) -> Channel:
        if channel.name == "position":
            moved = stroke * channel.values / leverage
            return replace(channel, values=moved * (1.0 + (1.0 - leverage) * moved))
        return replace(channel, values=force * channel.values) if channel.name == "force" else channel

    return replace(recording, channels={name: change(channel) for name, channel in recording.channels.items()})


def _noise(time: F, rng: Generator) -> F:
    fast, slow = rng.uniform(5.0, 18.0), rng.uniform(0.5, 2.0)
    parts = [NoiseStroke(0.04, fast, 4).samples(time, rng), NoiseStroke(0.04, slow, 4).samples(time, rng)]
    return np.asarray(parts[0] + rng.uniform(0.3, 2.0) * parts[1])


def _road(time: F, rng: Generator) -> F:
    return np.asarray(RoadStroke(str(rng.choice(list("ABCD"))), rng.uniform(6.0, 35.0)).samples(time, rng))


def _sweep(time: F, rng: Generator) -> F:
    return Sweep(rng.uniform(0.3, 2.0), rng.uniform(8.0, 20.0), 0.02, rng.uniform(0.2, 0.8)).samples(time, rng)


def _drop(time: F, rng: Generator) -> F:
    """Return the strokes of a wheel that is dropped again and again: a jump that rings down, then standstill."""
    stroke, start = np.zeros(len(time)), 0.5
    while start < time[-1] - 1.0:
        since = np.maximum(time - start, 0.0)
        ring = np.exp(-since * rng.uniform(3.0, 8.0)) * np.sin(2.0 * np.pi * rng.uniform(1.5, 4.0) * since)
        stroke += rng.uniform(0.6, 1.0) * ring
        start += rng.uniform(1.5, 3.5)
    return stroke


def _stop_and_go(time: F, rng: Generator) -> F:
    """Return a road stroke between long stretches of standstill."""
    moving = np.zeros(len(time))
    for start in np.sort(rng.uniform(0.5, time[-1] - 3.0, 2)):
        moving[(time > start) & (time < start + rng.uniform(1.5, 3.0))] = 1.0
    return np.asarray(_road(time, rng) * sosfiltfilt(butter(2, 1.0, fs=1.0 / GRID_S, output="sos"), moving))


def _dyno(time: F, rng: Generator) -> F:
    """Return a sine whose amplitude grows in steps, as damper dynamometers run it."""
    steps = np.floor(time / time[-1] * 3.999) + 1.0
    frequency = float(np.exp(rng.uniform(np.log(0.5), np.log(6.0))))
    grown = sosfiltfilt(butter(2, 2.0, fs=1.0 / GRID_S, output="sos"), steps)
    return np.asarray(Sine(0.01, frequency).samples(time, rng) * grown)


def _sines(time: F, rng: Generator) -> F:
    frequencies = tuple(np.exp(rng.uniform(np.log(0.5), np.log(14.0), 5)).tolist())
    return SumOfSines(tuple(0.02 / f for f in frequencies), frequencies).samples(time, rng)


def _triangle(time: F, rng: Generator) -> F:
    return Triangle(0.02, rng.uniform(0.05, 0.4)).samples(time, rng)


def _frequency_modulation(time: F, rng: Generator) -> F:
    return FrequencyModulated(0.012, rng.uniform(0.5, 2.0), rng.uniform(4.0, 12.0)).samples(time, rng)


def _constant(span: tuple[float, float], rng: Generator) -> Current:
    return ConstantLevel(rng.uniform(*span))


def _current_steps(span: tuple[float, float], rng: Generator) -> Current:
    return Steps(tuple(rng.uniform(*span, 5).tolist()), rng.uniform(0.3, 2.0))


def _binary_current(span: tuple[float, float], rng: Generator) -> Current:
    return Binary(*span, shortest_s=0.05, mean_s=rng.uniform(0.1, 0.6))


def _noise_current(span: tuple[float, float], rng: Generator) -> Current:
    return FilteredNoise(*span, cutoff_Hz=rng.uniform(1.0, 8.0))


def _sine_current(span: tuple[float, float], rng: Generator) -> Current:
    return SineCurrent(*span, frequency_Hz=rng.uniform(0.1, 4.0))


def _following(span: tuple[float, float], rng: Generator) -> Current:
    return StrokeFollowing(*span, stroke_m=rng.uniform(0.005, 0.02), lag_s=rng.uniform(0.002, 0.02))


RIDES: dict[str, tuple[Stroke, Callable[[tuple[float, float], Generator], Current]]] = {
    "noise switched": (_noise, _binary_current),
    "noise constant": (_noise, _constant),
    "noise stepped": (_noise, _current_steps),
    "road constant": (_road, _constant),
    "road modulated": (_road, _noise_current),
    "road following": (_road, _following),
    "sweep constant": (_sweep, _constant),
    "sweep stepped": (_sweep, _current_steps),
    "drop constant": (_drop, _constant),
    "drop switched": (_drop, _binary_current),
    "stop and go": (_stop_and_go, _noise_current),
    "dyno sine": (_dyno, _constant),
    "sines swung": (_sines, _sine_current),
    "triangle stepped": (_triangle, _current_steps),
    "modulated switched": (_frequency_modulation, _binary_current),
}
