"""The parameters that map each signal to its topic and field: declared, and read into `Signals`."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from ces_observer.nodes.node_parameters import declare_anew, value_of
from ces_observer.nodes.observer_table import SIGNAL_KEYS
from ces_observer.signals import DEFAULTS, MOTIONS, Signals, override

SIGNALS = ("position", "current", "force", *MOTIONS)


def declare_signals(node: Node, prefix: str) -> None:
    """Declare the parameters of all signals; with the `prefix` of one damper they have no defaults."""
    for signal in SIGNALS:
        defaults = {**DEFAULTS[signal], "scale": 1.0, "offset": 0.0, "delay": 0.0} if signal in DEFAULTS else {}
        for key, meaning in SIGNAL_KEYS.items():
            free = (
                bool(prefix) or not defaults or key in ("scale", "offset", "delay")
            )  # not set, or perhaps set to a whole number
            descriptor = ParameterDescriptor(description=f"{signal}: {meaning}", read_only=True, dynamic_typing=free)
            declare_anew(node, f"{prefix}{signal}.{key}", None if prefix else defaults.get(key), descriptor)
    descriptor = ParameterDescriptor(
        description="current: known value in SI units instead of a topic", read_only=True, dynamic_typing=True
    )
    declare_anew(node, f"{prefix}current.constant", None, descriptor)


def read_signals(node: Node, prefix: str) -> Signals:
    """Return the signals of a damper, its own settings over the common ones; raises SignalsError."""
    mapping = {
        signal: override(_read_parameters(node, signal), _read_parameters(node, prefix + signal) if prefix else None)
        for signal in SIGNALS
    }
    mapping = {
        signal: keys for signal, keys in mapping.items() if keys or signal in DEFAULTS
    }  # the others are optional
    return Signals.from_mapping(mapping, f"parameters of '{prefix[:-1]}'" if prefix else "parameters")


def _read_parameters(node: Node, signal: str) -> dict[str, Any]:
    keys = {name: value_of(node, f"{signal}.{name}") for name in node.get_parameters_by_prefix(signal)}
    return {key: value for key, value in keys.items() if value is not None}
