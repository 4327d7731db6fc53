"""What a fit asks twice is computed once, and is what the simulation itself gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.gaps.users_dampers import record
from ces_data.arrays import F
from ces_gap.baseline import wrappers
from ces_gap.baseline.wrappers import RememberedSimulation
from ces_identify.simulations.simulation import FunctionSimulation

RECORDING = record("knee", {}, 1, seconds=1.0)


def counted() -> tuple[RememberedSimulation, list[float]]:
    """Return a simulation that overwrites its arguments, and the list of the values with which it was called."""
    calls: list[float] = []

    def force(time_s: F, position_m: F, current_A: F, *, gas_N_m: float = 1500.0, seal_N: float = 5.0) -> F:
        calls.append(gas_N_m)
        position_m *= gas_N_m
        return position_m + seal_N

    return RememberedSimulation(FunctionSimulation("f", force)), calls


def test_equal_calls_are_computed_once_and_others_anew() -> None:
    simulation, calls = counted()
    stiffer = simulation.with_values({"gas_N_m": 3000.0})
    forces = [s.force(RECORDING) for s in (simulation, stiffer, simulation, stiffer.with_values({}))]
    assert calls == [1500.0, 3000.0]
    np.testing.assert_array_equal(forces[3], stiffer.with_own_values.force(RECORDING))
    np.testing.assert_array_equal(forces[2], forces[0])
    assert stiffer.parameters[0].default == 3000.0


def test_other_inputs_and_constants_are_told_apart() -> None:
    simulation, calls = counted()
    position = RECORDING.channel("position")
    moved = replace(position, values=position.values + 1e-12)
    simulation.force(RECORDING)
    simulation.force(replace(RECORDING, channels={**RECORDING.channels, "position": moved}))
    simulation.force(replace(RECORDING, constants={"current": 1.0}))
    simulation.force(replace(RECORDING, channels={k: v for k, v in RECORDING.channels.items() if k != "force"}))
    assert len(calls) == 3  # the force is no input


def test_the_oldest_are_forgotten(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr(wrappers, "MAX_FORCES", 2)
    simulation, calls = counted()
    for gas in (1.0, 2.0, 3.0, 3.0, 1.0):
        simulation.with_values({"gas_N_m": gas}).force(RECORDING)
    assert calls == [1.0, 2.0, 3.0, 1.0]
