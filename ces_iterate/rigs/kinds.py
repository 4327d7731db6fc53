"""The kinds of rigs: the plan's section `rig` goes in, a rig comes out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from ces_identify.recordings.log_mapping import load_dyno_mapping
from ces_identify.recordings.signals_file import load_signals
from ces_iterate.errors import IterateError
from ces_iterate.plan.plan import Plan
from ces_iterate.rigs.folder import FolderRig
from ces_iterate.rigs.rig import RigAdapter
from ces_iterate.rigs.virtual import VirtualRig
from ces_rig.descriptions import build, quantity
from ces_rig.drive.strokes import take_kind

TOPIC_RIG = "ces_iterate.live.topic_rig"  # imported where it is needed only: it needs ROS 2


@dataclass(frozen=True)
class VirtualRigSettings:
    """Settings of the virtual rig."""

    damper: str = ""


@dataclass(frozen=True)
class FolderRigSettings:
    """Settings of a rig that an operator runs."""

    mapping: str = ""
    signals: str = ""
    poll_s: float = quantity(1.0, "s", "time between two looks into the folder", 0.01, 3600.0)


@dataclass(frozen=True)
class RosRigSettings:
    """Settings of a rig behind ROS 2 topics."""

    stroke_topic: str = "stroke_command"
    current_topic: str = "valve_command"
    signals: str = ""
    rate_hz: float = quantity(500.0, "Hz", "set points per second", 10.0, 2000.0)
    safe_current_A: float = quantity(0.4, "A", "current before, after and in trouble", 0.0, 100.0)
    deviation_m: float = quantity(0.01, "m", "distance from the set point at which a run is broken off", 1e-5, 1.0)
    approach_s: float = quantity(2.0, "s", "time of the move to the first stroke", 0.1, 60.0)
    silence_s: float = quantity(0.5, "s", "time without a position at which a run is broken off", 0.01, 60.0)


def _open_virtual(plan: Plan, settings: Any, where: str) -> RigAdapter:
    given = build(VirtualRigSettings, settings, where)
    rig = VirtualRig.load(plan.path(given.damper) if given.damper else None)
    low, high = rig.model.allowed_A
    if plan.limits.low_A < low or plan.limits.high_A > high:
        raise IterateError(f"{where}: the damper takes {low:g} to {high:g} A; set limits: low_A and high_A within")
    if plan.limits.stroke_m + abs(plan.limits.centre_m) > rig.model.reach_m:
        raise IterateError(f"{where}: the damper's ends are at {rig.model.reach_m:g} m; lower limits: stroke_m")
    return rig


def _open_folder(plan: Plan, settings: Any, where: str) -> RigAdapter:
    given = build(FolderRigSettings, settings, where)
    mapping = load_dyno_mapping(plan.path(given.mapping)) if given.mapping else None
    return FolderRig(mapping, load_signals(plan.path(given.signals) if given.signals else None), given.poll_s)


def _open_ros(plan: Plan, settings: Any, where: str) -> RigAdapter:
    given = build(RosRigSettings, settings, where)
    signals = load_signals(plan.path(given.signals) if given.signals else None)
    try:
        node_module = import_module(TOPIC_RIG)
    except ModuleNotFoundError as error:
        raise IterateError(f"{where}: kind is ros, but {error.name} is missing; source ROS 2 first") from None
    rig: RigAdapter = node_module.TopicRig(given, signals)
    return rig


RIG_SETTINGS: Mapping[str, type[Any]] = {
    "virtual": VirtualRigSettings,
    "folder": FolderRigSettings,
    "ros": RosRigSettings,
}
RIGS: Mapping[str, Callable[[Plan, Any, str], RigAdapter]] = {
    "virtual": _open_virtual,
    "folder": _open_folder,
    "ros": _open_ros,
}


def open_rig(plan: Plan) -> RigAdapter:
    """Return the plan's rig; raises a CesError that names the key at fault."""
    where = f"{plan.source}: rig"
    kind, settings = take_kind(plan.rig, RIGS, where)
    return RIGS[kind](plan, settings, where)
