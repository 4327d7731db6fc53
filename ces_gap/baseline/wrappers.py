"""Simulations around a simulation: one that takes its inputs on time, and one that computes nothing twice.

A simulation that interpolates the current between samples, where the real one is held, answers before it should; one
that filters the position answers late. `ces_gap.inputs.probes` measures by how much. A fit asks again and again for the
same values on the same inputs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline

from ces_data.arrays import F
from ces_data.recording import Channel, Recording
from ces_identify.simulations.simulation import Parameter, Simulation, with_defaults
from ces_observer.records import bounded

MAX_LEAD_SAMPLES = 10.0
MAX_DELAY_S = 0.1


@dataclass(frozen=True)
class InputTiming:
    """The lead of the simulation's current, in samples of the position, and its delay of the position [s]."""

    current_lead_samples: float = bounded(-MAX_LEAD_SAMPLES, MAX_LEAD_SAMPLES, default=0.0)
    position_delay_s: float = bounded(0.0, MAX_DELAY_S, default=0.0)

    def __bool__(self) -> bool:
        return self != ON_TIME


ON_TIME = InputTiming()


@dataclass(frozen=True)
class RetimedSimulation(Simulation):
    """A simulation whose inputs are shifted against the `timing` that was found in it."""

    simulation: Simulation
    timing: InputTiming

    @property
    def innermost(self) -> Simulation:
        """The simulation inside."""
        return self.simulation.innermost

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the simulation inside."""
        return self.simulation.parameters

    def with_values(self, values: Mapping[str, float]) -> RetimedSimulation:
        """Return the same retiming of the simulation with other values."""
        return replace(self, simulation=self.simulation.with_values(values))

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample (n,), as if the simulation took its inputs on time."""
        channels = dict(recording.channels)
        if self.timing.current_lead_samples and "current" not in recording.constants:
            channels["current"] = _delay_current(recording, self.timing.current_lead_samples)
        if self.timing.position_delay_s:
            channels["position"] = _advance_position(recording.channel("position"), self.timing.position_delay_s)
        return self.simulation.force(replace(recording, channels=channels))


def _delay_current(recording: Recording, lead: float) -> Channel:
    """Return the current at the position samples, each the mean of the held one over a sample interval around it.

    The interval begins `lead` samples before, so that interpolation (0.5) has the mean delay of the held current.
    """
    logged, clock = recording.channel("current").in_order(), recording.channel("position").in_order().stamps_ns
    seconds, at = (logged.stamps_ns - clock[0]) * 1e-9, (clock - clock[0]) * 1e-9
    step = float(np.median(np.diff(at)))
    edges = np.concatenate(
        [[min(seconds[0], at[0]) - 20.0 * step], seconds[1:], [max(seconds[-1], at[-1]) + 20 * step]]
    )
    charge = np.concatenate([[0.0], np.cumsum(logged.values * np.diff(edges))])
    before, after = (np.interp(at + (share - lead) * step, edges, charge) for share in (0.0, 1.0))
    return replace(logged, stamps_ns=clock, values=(after - before) / step)


def _advance_position(logged: Channel, delay_s: float) -> Channel:
    """Return the position that comes `delay_s` later."""
    ordered = logged.in_order()
    start = ordered.stamps_ns[0]
    spline = CubicSpline((ordered.stamps_ns - start) * 1e-9, ordered.values)
    at = np.clip((logged.stamps_ns - start) * 1e-9 + delay_s, 0.0, (ordered.stamps_ns[-1] - start) * 1e-9)
    return replace(logged, values=np.where(np.isfinite(logged.values), spline(at), np.nan))


MAX_FORCES, MAX_OPENED = 512, 8  # that are kept: of 20 s at 1 kHz, a force has 160 kB
INPUTS = ("position", "current", "speed", "acceleration")
K = TypeVar("K")
V = TypeVar("V")


@dataclass(frozen=True)
class RememberedSimulation(Simulation):
    """A simulation with other `values` of its parameters, all of which share the forces and recordings kept."""

    original: Simulation
    values: Mapping[str, float] = field(default_factory=dict, hash=False)
    forces: dict[tuple[object, ...], F] = field(default_factory=dict, hash=False, repr=False)
    opened: dict[bytes, Any] = field(default_factory=dict, hash=False, repr=False)

    @property
    def with_own_values(self) -> Simulation:
        """The simulation with the values, which remembers nothing."""
        return self.original.with_values(self.values)

    @property
    def innermost(self) -> Simulation:
        """The simulation inside all wrappers, with the values."""
        return self.with_own_values.innermost

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the simulation, with the values as their defaults."""
        return with_defaults(self.original.parameters, self.values)

    def with_values(self, values: Mapping[str, float]) -> RememberedSimulation:
        """Return the simulation with other values."""
        return replace(self, values={**self.values, **values})

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample (n,)."""
        inputs = _digest(recording)
        values = (inputs, *sorted(self.values.items()))

        def run() -> F:
            opened = _recall(self.opened, inputs, lambda: self.original.open(recording), MAX_OPENED)
            force = self.with_own_values.run(opened)
            force.flags.writeable = False
            return force

        return _recall(self.forces, values, run, MAX_FORCES)


def _recall(memory: dict[K, V], key: K, compute: Callable[[], V], most: int) -> V:
    """Return what is kept under a key, computed if it is not; the oldest of more than `most` is dropped."""
    if key not in memory:
        value = compute()
        if len(memory) >= most:
            del memory[next(iter(memory))]
        memory[key] = value
    return memory[key]


def _digest(recording: Recording) -> bytes:
    """Return a hash of all that a simulation may read of a recording."""
    digest = hashlib.blake2b(repr((recording.name, sorted(recording.constants.items()))).encode(), digest_size=16)
    for name in INPUTS:
        if name in recording.channels:
            channel = recording.channels[name]
            digest.update(channel.stamps_ns.tobytes())
            digest.update(channel.values.tobytes())
    return digest.digest()
