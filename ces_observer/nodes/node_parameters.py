"""Declares parameters from a table, with description and range.

rclpy has already declared those that were set at the start (automatically_declare_parameters_from_overrides), without
description; so unknown parameters can be reported.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any, ClassVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from ces_observer.errors import CesError, ModelError
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.parameter_table import ParameterSpec, find_unknown

NULL = "null"  # what `ros2 param dump` writes for a parameter that is not set, and ROS 2 then reads as a text


class TableNode(GuardedNode):
    """A guarded node whose parameters are declared from a table; raises CesError for a parameter without a type.

    `MAY_BE_EMPTY` names the lists that may be empty; ROS 2 has no type for an empty list.
    """

    MAY_BE_EMPTY: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, name: str) -> None:
        try:
            super().__init__(name, automatically_declare_parameters_from_overrides=True)
        except ValueError:
            raise CesError("a parameter has no value or is an empty list; remove it") from None

    def declare_parameters(self, namespace: str, parameters: list[Any], ignore_override: bool = False) -> list[Any]:
        """Do the same as rclpy, but leave empty lists in MAY_BE_EMPTY to `declare`."""
        typed = [one for one in parameters if not (ignore_override and one[0] in self.MAY_BE_EMPTY and one[1] is None)]
        declared: list[Any] = super().declare_parameters(namespace, typed, ignore_override)
        return declared


def declare_table(node: Node, table: Iterable[ParameterSpec], groups: Collection[str] = ()) -> dict[str, Any]:
    """Declare all of `table`, warn of unknown parameters, and return the values by name.

    Names below one of `groups` are not unknown. Raises CesError or rclpy's ParameterException if a value is wrong.
    """
    values = {spec.name: declare(node, spec) for spec in table}
    warn_of_unknown(node, values, groups)
    return values


def warn_of_unknown(
    node: Node, known: Collection[str], groups: Collection[str] = (), owners: Collection[str] = ()
) -> None:
    """Log a warning for each parameter that `find_unknown` returns."""
    for name in find_unknown(node.get_parameters_by_prefix(""), known, groups, owners):
        node.get_logger().warning(f"parameter '{name}' is unknown and ignored; known are {', '.join(sorted(known))}")


def declare(node: Node, spec: ParameterSpec) -> Any:
    """Declare `spec` and return its value; raises CesError or rclpy's ParameterException if the value is wrong."""
    value = declare_anew(node, spec.name, spec.default, descriptor_of(spec))
    return spec.check_value([] if value is None and isinstance(spec.default, list) else value)


def declare_unset(node: Node, spec: ParameterSpec, name: str) -> None:
    """Declare `spec` as `name` without a default, so that it may stay unset. Raises CesError if the value is wrong.

    It is typed dynamically, because rclpy cannot return several parameters if one of a fixed type is not set.
    """
    descriptor = descriptor_of(spec)
    descriptor.dynamic_typing = True
    descriptor.description += "; not set: as for all dampers"
    value = declare_anew(node, name, None, descriptor)
    if value is not None:
        spec.check_value(value, name)


def descriptor_of(spec: ParameterSpec) -> ParameterDescriptor:
    """Return the ROS descriptor of `spec`."""
    constraints = f"one of {', '.join(spec.one_of)}" if spec.one_of else ""
    descriptor = ParameterDescriptor(
        description=spec.meaning, read_only=not spec.live, additional_constraints=constraints
    )
    if spec.range is not None and isinstance(spec.default, int):
        descriptor.integer_range = [IntegerRange(from_value=int(spec.range[0]), to_value=int(spec.range[1]), step=1)]
    elif spec.range is not None:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(spec.range[0]), to_value=float(spec.range[1]))
        ]
    return descriptor


def declare_anew(node: Node, name: str, default: Any, descriptor: ParameterDescriptor) -> Any:
    """Declare a parameter, again if it was declared without description, and return its value.

    NULL for a parameter without a default leaves it unset.
    """
    is_null = False
    if node.has_parameter(name):
        is_null = default is None and node.get_parameter_or(name).value == NULL
        node.undeclare_parameter(name)
    return node.declare_parameter(name, default, descriptor, ignore_override=is_null).value


def value_of(node: Node, name: str) -> Any:
    """Return the value of a parameter, None if it is not set or not declared."""
    return node.get_parameter_or(name).value


def model_path(text: str) -> Path:
    """Return the path in a parameter `model`; raises ModelError if it is empty."""
    if not text:
        raise ModelError("parameter 'model' is not set; set the path of a model file: -p model:=/path/model.json")
    return Path(text).expanduser()
