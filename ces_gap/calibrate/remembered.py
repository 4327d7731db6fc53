"""A simulation that computes nothing twice: a fit asks again and again for the same values on the same inputs."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from ces_data.arrays import F
from ces_data.recording import Recording
from ces_identify.simulations.parameters import Parameter, with_defaults
from ces_identify.simulations.simulation import Simulation

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
    def changed(self) -> Simulation:
        """The simulation with the values, which remembers nothing."""
        return self.original.with_values(self.values)

    @property
    def innermost(self) -> Simulation:
        """The simulation inside all wrappers, with the values."""
        return self.changed.innermost

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
            force = self.changed.run(opened)
            force.flags.writeable = False
            return force

        return _recall(self.forces, values, run, MAX_FORCES)


def _recall(memory: dict[K, V], key: K, compute: Callable[[], V], most: int) -> V:
    """Return what is kept under a key, computed if it is not; the oldest of more than `most` is dropped."""
    if key not in memory:
        found = compute()
        if len(memory) >= most:
            del memory[next(iter(memory))]
        memory[key] = found
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
