"""Parts of a network that was fitted to the real recordings, in the form of effects.

A static map of force over speed and current lacks several effects at once, and no twin of it shows one after another.
A network of the real recordings replaces it (`Recalibration`): the valves' curves, without the dynamics that no map
has. Each of these is a part, and a cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, ClassVar

from ces_gap.effects.effect import SIMULATION, Effect, TwinRun, magnitude
from ces_gap.effects.library.compressibility import Compressibility
from ces_gap.effects.library.current_hysteresis import CurrentHysteresis
from ces_gap.effects.library.friction import FrictionForce
from ces_gap.effects.library.inertia import Inertia
from ces_gap.effects.library.mount_compliance import MountCompliance
from ces_gap.effects.library.valve_lag import ValveLag
from ces_gap.errors import GapError
from ces_gap.limits import SearchLimits
from ces_identify.physical.quantities import read_quantities
from ces_observer.errors import ModelError
from ces_observer.records import bounded, part, read_record, write_record
from ces_observer.structures.hydraulic import Hydraulic

FORM = "network"
MIN_CHANGE = 0.02  # relative, of a quantity that a report names


@dataclass(frozen=True)
class NetworkPart(Effect):
    """Numbers of a network, on the way from those of `before` to those of `after`; dead times count `tick_s`."""

    before: Hydraulic = part()
    after: Hydraulic = part()
    tick_s: float = bounded(1e-6, 1.0)

    groups: ClassVar[tuple[str, ...]] = ()  # of a fit's parameters (`ces_identify.physical.layout`)
    numbers: ClassVar[tuple[str, ...]] = ()  # the same in a model file
    form, reruns, edits = FORM, False, True
    needs = "a simulation without it"
    parameters = (magnitude("share", 0.0, 2.0, (1.0,), "share of what the network of the real recordings has"),)

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        """Return the run with the part's numbers."""
        before, after = (_at_steps(network, self.tick_s, run.step_s) for network in (self.before, self.after))
        return replace(run, body=_exchange(run.body, before, after, values[0], self.numbers))

    def read_quantities(self) -> dict[str, float]:
        """Return the quantities of the damper that the part changes, by their names, which hold the units."""
        stroke, whole = self.before.side.position_m, _exchange(self.before, self.before, self.after, 1.0, self.numbers)
        old, new = (read_quantities(body, self.tick_s, (stroke[0], stroke[-1])) for body in (self.before, whole))
        return {n: new[n] for n in new if abs(new[n] - old[n]) > MIN_CHANGE * max(abs(old[n]), abs(new[n]))}

    def as_json(self) -> dict[str, Any]:
        """Return both networks as plain values."""
        return {"tick_s": self.tick_s, "before": write_record(self.before), "after": write_record(self.after)}


class Recalibration(NetworkPart):
    """The network in place of the simulation: F + share (network - F)."""

    name, stage, prior_share = "calibration", SIMULATION, SearchLimits.MAP
    summary, needs = "the simulation's force map is off", "speeds or currents at which the simulation is off"

    def edit(self, run: TwinRun, values: Sequence[float]) -> TwinRun:
        """Return the run with the network."""
        return replace(run, body=_at_steps(self.before, self.tick_s, run.step_s))


class StoredVolume(NetworkPart, Compressibility):
    """What both chambers store, and the air in their oil."""

    groups = numbers = ("compression_m_N", "rebound_m_N", "compression_growth_1_m", "rebound_growth_1_m", "air")


class ElasticMount(NetworkPart, MountCompliance):
    """The mount's spring and creep."""

    groups = numbers = ("mount_m_N", "creep_m_Ns")


class Seals(NetworkPart, FrictionForce):
    """Springs that yield, behind the mount."""

    groups = ("friction", "friction_yield", "friction_moved", "friction_growth_1_N")
    numbers = ("friction", "friction_growth_1_N")


class SlowValve(NetworkPart, ValveLag):
    """Lags and dead time of the valve."""

    groups = numbers = ("rise_s", "fall_s", "delay_ticks")


class MagneticLoop(NetworkPart, CurrentHysteresis):
    """The loop of setting over current."""

    groups = numbers = ("hysteresis_A",)


class MovingMass(NetworkPart, Inertia):
    """The mass between piston and sensor."""

    groups = numbers = ("mass_kg",)


PARTS: tuple[type[NetworkPart], ...] = (StoredVolume, ElasticMount, Seals, SlowValve, MagneticLoop, MovingMass)


def read_part(name: str, networks: object) -> NetworkPart:
    """Return the part of a network from `NetworkPart.as_json`; raises GapError or ModelError."""
    kinds: dict[str, type[NetworkPart]] = {kind.name: kind for kind in PARTS} | {Recalibration.name: Recalibration}
    if name not in kinds:
        raise GapError(f"effect '{name}' has no form '{FORM}'; expected one of {', '.join(kinds)}")
    return read_record(kinds[name], networks, "networks", ModelError, complete=True)


def _at_steps(network: Hydraulic, tick_s: float, step_s: float) -> Hydraulic:
    valve = network.valve
    return replace(network, valve=replace(valve, delay_ticks=valve.delay_ticks * tick_s / step_s))


def _exchange(into: Any, before: Any, after: Any, share: float, names: Sequence[str]) -> Any:
    """Return the record `into` with the fields `names`, also those of records in it, between `before` and `after`.

    A part that these have not, such as a bypass, stays as it is.
    """
    changed = {}
    for field in fields(into):
        own, low, high = (getattr(record, field.name) for record in (into, before, after))
        if low is None or high is None:
            continue
        if field.name in names:
            changed[field.name] = _between(low, high, share)
        elif is_dataclass(own):
            changed[field.name] = _exchange(own, low, high, share, names)
    return replace(into, **changed)


def _between(before: Any, after: Any, share: float) -> Any:
    if isinstance(before, tuple):
        return tuple(_between(*pair, share) for pair in zip(before, after, strict=True))
    if is_dataclass(before):
        names = [field.name for field in fields(before)]
        return _exchange(before, before, after, share, names)
    return max(before + share * (after - before), min(before, after))
