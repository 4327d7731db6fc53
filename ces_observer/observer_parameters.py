"""Parameters of the observer node: declared once, with what they mean, and read into checked settings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from ces_observer.certificate import is_contraction
from ces_observer.errors import ModelError, SignalsError
from ces_observer.model import Model, load_model
from ces_observer.signals import DEFAULTS, NAMES, Constant, Signal, Signals

MAX_AGE = "max_age_s"
ALLOW_UNCERTIFIED = "allow_uncertified"
INPUTS = ("position", "current")
KEYS = {
    "topic": "topic; a relative name is resolved in the node's namespace",
    "type": "message type, such as sensor_msgs/msg/JointState",
    "field": "path to the number in the message, such as data, wrench.force.z or position[rear_damper]",
    "scale": "value in SI units = scale * number + offset",
    "offset": "value in SI units = scale * number + offset",
}
_OTHERS = (*(f"{name}." for name in NAMES), "qos_overrides.", "use_sim_time", "start_type_description_service")


@dataclass(frozen=True)
class Settings:
    """What one damper is observed with."""

    name: str
    model: Model
    model_path: Path
    position: Signal
    current: Signal | Constant
    max_age_s: float


def declare_settings(node: Node) -> Settings:
    """Declare and read the node's parameters; raises CesError or rclpy's ParameterException."""
    model_path = _declare(node, "model", "", "path of the model file (model.json); must be given")
    name = _declare(node, "name", "", "joint name in the estimate; empty: the one in position.field, else 'damper'")
    max_age_s = _declare(node, MAX_AGE, 0.5, _MAX_AGE_HELP, read_only=False, upper=3600.0)
    uncertified = _declare(node, ALLOW_UNCERTIFIED, False, "run a model whose stability cannot be proved (unsafe)")
    signals = _declare_signals(node)
    _warn_of_unknown(node)
    if not model_path:
        raise ModelError("parameter 'model' is not set; give the path of a model file: -p model:=/path/model.json")
    position = signals["position"]
    if isinstance(position, Constant):
        raise SignalsError("signal 'position' is constant; expected topic, type and field of a measured position")
    path = Path(model_path).expanduser()
    model = load_model(path)
    if not uncertified:
        _require_stable(model, path)
    return Settings(name or _joint(position), model, path, position, signals["current"], max_age_s)


def _require_stable(model: Model, path: Path) -> None:
    """Prove the model's stability anew, whatever the file claims; raises ModelError."""
    if not is_contraction(model):
        raise ModelError(
            f"{path}: its past forces are not proved to count for less than one over its input envelope; identify it "
            f"anew with a certificate, or set {ALLOW_UNCERTIFIED}: true to run it all the same"
        )


_MAX_AGE_HELP = (
    "largest difference between a position's stamp and the node's clock at which its force is published [s]; 0: any"
)


def _declare_signals(node: Node) -> Signals:
    for signal in INPUTS:
        defaults = {**DEFAULTS[signal], "scale": 1.0, "offset": 0.0}
        for key, meaning in KEYS.items():
            _declare(
                node, f"{signal}.{key}", defaults[key], f"{signal}: {meaning}", any_type=key in ("scale", "offset")
            )
    _declare(node, "current.constant", None, "current: known value in SI units instead of a topic", any_type=True)
    given = {signal: node.get_parameters_by_prefix(signal) for signal in INPUTS}
    mapping = {
        signal: {key: parameter.value for key, parameter in keys.items() if parameter.value is not None}
        for signal, keys in given.items()
    }
    return Signals.from_mapping(mapping, "parameters")


def _declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    *,
    read_only: bool = True,
    any_type: bool = False,
    upper: float | None = None,
) -> Any:
    """Declare a parameter anew with its description, as all given ones are first declared without, and return it."""
    descriptor = ParameterDescriptor(description=description, read_only=read_only, dynamic_typing=any_type)
    if upper is not None:
        descriptor.floating_point_range = [FloatingPointRange(from_value=0.0, to_value=upper)]
    if node.has_parameter(name):
        node.undeclare_parameter(name)
    return node.declare_parameter(name, default, descriptor).value


def _warn_of_unknown(node: Node) -> None:
    known = ("model", "name", MAX_AGE, ALLOW_UNCERTIFIED)
    for name in node.get_parameters_by_prefix(""):
        if name not in known and not name.startswith(_OTHERS):
            node.get_logger().warning(f"parameter '{name}' is unknown and ignored; known are {', '.join(known)}")


def _joint(position: Signal) -> str:
    return next((element for _, element in position.field.steps if isinstance(element, str)), "damper")
