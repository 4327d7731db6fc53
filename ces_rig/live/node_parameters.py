"""Parameters of the rig node: the fields of its settings, declared with the ranges and descriptions they carry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, dataclass, field, fields, is_dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from ces_observer.nodes.executors import AUTO, CHOICES
from ces_rig.descriptions import choice, quantity
from ces_rig.errors import RigError
from ces_rig.live.rig import LIVE, Settings
from ces_rig.parts import put

NO_WORDS = [""]  # an empty list has no type in ROS 2


@dataclass(frozen=True)
class NodeSettings:
    """What the node adds to a live rig; with `publish_clock` it is the source of time."""

    joint: str = field(default="rear_damper", metadata={"unit": "", "what": "joint name, and frame of all stamps"})
    stamped_current: bool = field(
        default=False,
        metadata={"unit": "", "what": "publish the current as JointState (effort[joint], in A) instead of Float64"},
    )
    publish_clock: bool = field(default=False, metadata={"unit": "", "what": "make simulated time and publish /clock"})
    real_time_factor: float = quantity(
        1.0, "1", "with publish_clock: simulated over real time; 0: as fast as samples are taken", 0.0, 1e3
    )
    answer_s: float = quantity(
        0.0, "s", "with real_time_factor 0: longest wait for a command after each sample; 0: none", 0.0, 10.0
    )
    executor: str = choice(AUTO, "how callbacks are run", CHOICES)


def declare_settings(node: Node) -> tuple[NodeSettings, Settings]:
    """Declare and read all parameters; raises RigError or rclpy's ParameterException."""
    own = put(NodeSettings(), _declared(node, NodeSettings()), "parameters")
    values = _declared(node, Settings())
    values["withheld"] = [text for text in values["withheld"] or () if text]  # an empty list comes as None
    if node.get_parameter("use_sim_time").value and not own.publish_clock:
        raise RigError(
            "use_sim_time is true, but the rig makes time itself; set publish_clock: true as well, or neither"
        )
    return own, put(Settings(), values, "parameters")


def _declared(node: Node, defaults: Any) -> dict[str, Any]:
    return {name: node.declare_parameter(name, *declared).value for name, *declared in _parameters(defaults)}


def _parameters(defaults: Any, prefix: str = "") -> Iterator[tuple[str, Any, ParameterDescriptor]]:
    for f in fields(defaults):
        value, name = getattr(defaults, f.name), f"{prefix}{f.name}"
        if is_dataclass(value):
            yield from _parameters(value, f"{name}.")
        else:
            default = list(value) or NO_WORDS if isinstance(value, tuple) else value
            yield name, default, _descriptor(f, value, read_only=name not in LIVE)


def _descriptor(f: Field[Any], value: Any, *, read_only: bool) -> ParameterDescriptor:
    unit, meta = f.metadata["unit"], f.metadata
    descriptor = ParameterDescriptor(description=meta["what"] + (f" [{unit}]" if unit else ""), read_only=read_only)
    if "options" in meta:
        descriptor.additional_constraints = "one of " + ", ".join(meta["options"])
    elif isinstance(value, float):
        descriptor.floating_point_range = [FloatingPointRange(from_value=meta["low"], to_value=meta["high"])]
    elif isinstance(value, int) and not isinstance(value, bool):
        descriptor.integer_range = [IntegerRange(from_value=meta["low"], to_value=meta["high"], step=1)]
    return descriptor
