"""Sensors of the rig: true signals on a fine grid go in, a recording as from a logger comes out.

Each sensor has its own rate, phase, stamp jitter, noise, quantum and dropouts. Stamps start at a fixed epoch and all
random numbers depend on the seed, so a recording repeats exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from scipy.interpolate import PchipInterpolator

from ces_data.arrays import F
from ces_data.recording import Channel, Recording
from ces_observer.records import choice, quantity

EPOCH_NS = 1_293_840_000_000_000_000  # 2011-01-01 00:00 UTC, the year of the thesis
GRID_S = 0.5e-3  # [s] grid of the commands and of the true signals
STREAMS = {"stroke": 0, "current": 1, "position": 2, "measured_current": 3, "force": 4, "temperature": 5, "actuator": 7}


@dataclass(frozen=True)
class Sensor:
    """One sensor; noise and quantum are in the signal's own SI unit."""

    noise: float = quantity(0.0, "(signal's unit)", "standard deviation of white noise", 0.0, 1e6)
    quantum: float = quantity(0.0, "(signal's unit)", "quantisation step; 0 for none", 0.0, 1e6)
    bias: float = quantity(0.0, "(signal's unit)", "constant error", -1e6, 1e6)
    rate_Hz: float = quantity(1000.0, "Hz", "samples per second", 0.1, 1e4)
    phase_s: float = quantity(0.0, "s", "time of the first sample", 0.0, 10.0)
    jitter_s: float = quantity(0.0, "s", "standard deviation of the stamp error", 0.0, 0.1)
    dropout: float = quantity(0.0, "1", "probability that a sample is not logged", 0.0, 0.9)

    def sample(self, time_s: F, true: F) -> tuple[F, F]:
        """Return sampling times [s] and noise-free values of `true` (PCHIP: a switched current does not overshoot)."""
        at = np.arange(time_s[0] + self.phase_s, time_s[-1] + 1e-9, 1.0 / self.rate_Hz)
        return at, np.asarray(PchipInterpolator(time_s, true)(at))

    def measure(self, name: str, unit: str, time_s: F, true: F, epoch_ns: int, rng: Generator) -> Channel:
        """Return the logged channel; stamps stay in order for any jitter."""
        at, value = self.sample(time_s, true)
        value = value + self.bias + self.noise * rng.standard_normal(len(at))
        if self.quantum > 0.0:
            value = self.quantum * np.round(value / self.quantum)
        stamps = epoch_ns + np.round(1e9 * (at + self.jitter_s * rng.standard_normal(len(at)))).astype(np.int64)
        logged = rng.random(len(at)) >= self.dropout
        return Channel(name, unit, np.maximum.accumulate(stamps[logged]), value[logged])


@dataclass(frozen=True)
class Sensors:
    """The rig's sensors. The current is measured in the coil, or logged as commanded."""

    position: Sensor = field(default_factory=lambda: Sensor(noise=15e-6, quantum=12e-6, phase_s=0.4e-3, jitter_s=20e-6))
    current: Sensor = field(default_factory=lambda: Sensor(noise=1.5e-3, quantum=1e-3, rate_Hz=500.0, jitter_s=30e-6))
    force: Sensor = field(default_factory=lambda: Sensor(noise=8.0, quantum=1.0, phase_s=0.6e-3, jitter_s=20e-6))
    temperature: Sensor = field(default_factory=lambda: Sensor(noise=0.2, quantum=0.1, rate_Hz=10.0))
    current_source: str = choice("measured", "which current is logged", ("measured", "commanded"))
    log_temperature: bool = False
    log_command: bool = False  # the stroke as commanded, channel `command`


@dataclass(frozen=True)
class Truth:
    """Noise-free signals on the uniform grid `time_s`; every array of shape (n,)."""

    time_s: F
    stroke_m: F
    commanded_A: F
    coil_A: F
    force_N: F
    oil_degC: F
    command_m: F | None = None  # stroke as commanded, if an actuator made `stroke_m` of it


def measure_signals(true: Truth, sensors: Sensors, seed: int, name: str, repeat: int = 0) -> Recording:
    """Return the recording, with this name, of the signals `true` by `sensors`; `repeat` gives other noise."""
    current = true.coil_A if sensors.current_source == "measured" else true.commanded_A
    logged: list[tuple[Sensor, str, str, F, str]] = [
        (sensors.position, "position", "m", true.stroke_m, "position"),
        (sensors.current, "current", "A", current, "measured_current"),
        (sensors.force, "force", "N", true.force_N, "force"),
    ]
    if sensors.log_temperature:
        logged.append((sensors.temperature, "temperature", "degC", true.oil_degC, "temperature"))
    if sensors.log_command and true.command_m is not None:  # an ideal sensor draws numbers, but does not use them
        logged.append((Sensor(), "command", "m", true.command_m, "stroke"))
    channels = {
        channel: sensor.measure(channel, unit, true.time_s, signal, EPOCH_NS, make_rng(seed, stream, repeat))
        for sensor, channel, unit, signal, stream in logged
    }
    return Recording(name, channels)


def make_rng(seed: int, stream: str, repeat: int = 0) -> np.random.Generator:
    """Return the random numbers of one use (of STREAMS), so that a change in one does not affect the others."""
    return np.random.default_rng([seed, STREAMS[stream], *([repeat] if repeat else [])])
