"""The observer node's parameters, read into checked settings of the node and of each damper.

With names in `dampers`, each damper has parameters NAME.model, NAME.position.topic and so on; one that is not set has
the value of the parameter without the name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from ces_observer.errors import CesError, SignalsError
from ces_observer.model import Model, load_model
from ces_observer.nodes.model_check import require_stable
from ces_observer.nodes.node_parameters import (
    declare,
    declare_anew,
    declare_unset,
    model_path,
    value_of,
    warn_of_unknown,
)
from ces_observer.nodes.observer_table import DAMPERS, DAMPERS_MEANING, NAME, OF_A_DAMPER, OF_THE_NODE
from ces_observer.nodes.parameter_table import ParameterSpec
from ces_observer.nodes.signal_parameters import declare_signals, read_signals
from ces_observer.signals import NAMES, Constant, Signal, Signals

LIVE = {spec.name: spec for spec in OF_A_DAMPER if spec.live}
_PLAIN_NAME = "expected letters, digits and underscores that do not begin with a digit"


@dataclass(frozen=True)
class DamperSettings:
    """The settings of one damper; `key` is its name in `dampers`, empty if it is the only one."""

    key: str
    name: str
    model: Model
    model_path: Path
    signals: Signals
    values: dict[str, Any]  # by the names in OF_A_DAMPER, as they were at the start

    @property
    def prefix(self) -> str:
        """Prefix of its own parameters."""
        return f"{self.key}." if self.key else ""

    @property
    def topics(self) -> str:
        """Prefix of its topics and services."""
        return f"~/{self.key}/" if self.key else "~/"


@dataclass(frozen=True)
class ObserverNodeSettings:
    """The node's settings: `values` by the names in OF_THE_NODE."""

    values: dict[str, Any]
    dampers: tuple[DamperSettings, ...]


def declare_settings(node: Node) -> ObserverNodeSettings:
    """Declare and read the node's parameters; raises CesError or rclpy's ParameterException."""
    values = {spec.name: declare(node, spec) for spec in OF_THE_NODE}
    keys = _declare_dampers(node)
    for spec in (*OF_A_DAMPER, NAME):
        declare(node, spec)
        for key in keys:
            declare_unset(node, spec, f"{key}.{spec.name}")
    for prefix in ("", *(f"{key}." for key in keys)):
        declare_signals(node, prefix)
    known = {spec.name for spec in (*OF_THE_NODE, *OF_A_DAMPER, NAME)} | {DAMPERS}
    warn_of_unknown(node, known, NAMES, keys)
    return ObserverNodeSettings(values, tuple(_read_settings(node, key) for key in keys or ("",)))


def live_value(node: Node, settings: DamperSettings, name: str) -> Any:
    """Return the present value for a damper: its own, or else the common one."""
    own = value_of(node, settings.prefix + name) if settings.key else None
    return value_of(node, name) if own is None else own


def governing_parameter(node: Node, settings: DamperSettings, name: str) -> str:
    """Return the name of the parameter whose value now applies to a damper."""
    own = settings.prefix + name
    return name if value_of(node, own) is None else own


def find_refusal(node: Node, parameters: Sequence[Parameter]) -> str:
    """Return why one of these parameters cannot be set, empty if all can."""
    try:
        for parameter in parameters:
            spec = LIVE.get(parameter.name.rpartition(".")[2])
            if spec is not None and node.has_parameter(parameter.name):
                value = spec.check_value(parameter.value, parameter.name)
                if spec.name == "model":
                    load_model(model_path(value))
    except CesError as error:
        return str(error)
    return ""


def _read_settings(node: Node, key: str) -> DamperSettings:
    prefix = f"{key}." if key else ""
    values = {spec.name: spec.check_value(_read_value(node, prefix, spec), prefix + spec.name) for spec in OF_A_DAMPER}
    signals = read_signals(node, prefix)
    if isinstance(signals["position"], Constant):
        raise SignalsError(
            f"signal '{prefix}position' is constant; expected topic, type and field of a measured position"
        )
    path = model_path(values["model"])
    model = load_model(path)
    if not values["allow_uncertified"]:
        require_stable(model, str(path))
    name = value_of(node, prefix + NAME.name) or _joint_name(signals["position"]) or key or "damper"
    return DamperSettings(key, name, model, path, signals, values)


def _read_value(node: Node, prefix: str, spec: ParameterSpec) -> Any:
    own = value_of(node, prefix + spec.name)
    return value_of(node, spec.name) if own is None else own


def _declare_dampers(node: Node) -> tuple[str, ...]:
    descriptor = ParameterDescriptor(description=DAMPERS_MEANING, read_only=True, dynamic_typing=True)
    keys = declare_anew(node, DAMPERS, None, descriptor) or []
    if not isinstance(keys, list) or not all(isinstance(key, str) for key in keys):
        raise CesError(f"parameter '{DAMPERS}' is {keys!r}; expected a list of names, such as [front, rear]")
    for key in keys:
        if not key.isidentifier() or not key.isascii() or key in NAMES:
            raise CesError(f"parameter '{DAMPERS}' has '{key}'; {_PLAIN_NAME}, and not the name of a signal")
    if len(set(keys)) < len(keys):
        raise CesError(f"parameter '{DAMPERS}' is {list(keys)}; expected each name once")
    return tuple(keys)


def _joint_name(position: Signal | Constant) -> str:
    steps = position.field.steps if isinstance(position, Signal) else ()
    return next((element for _, element in steps if isinstance(element, str)), "")
