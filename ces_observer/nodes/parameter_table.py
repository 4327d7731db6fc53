"""Parameters of nodes as tables: name, default, meaning, range, and whether they can change while the node runs.

Knows no ROS: a node declares its table by `node_parameters.declare_table`; documentation and tests read the same table.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from ces_observer.errors import CesError

Value = bool | int | float | str | list[str] | list[float]
KINDS = {bool: "truth value (true or false)", int: "whole number", float: "number", str: "text", list: "list"}
NO_WORDS = [""]  # ROS 2 has no empty list of texts; empty texts are left out
OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides")


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter; `lowest` and `highest` bound numbers, both included, `one_of` lists what a text may be."""

    name: str
    default: Value
    meaning: str
    lowest: float | None = None
    highest: float | None = None
    one_of: tuple[str, ...] = ()
    live: bool = False

    @property
    def range(self) -> tuple[float, float] | None:
        """Lowest and highest number allowed, if it has bounds."""
        return None if self.lowest is None or self.highest is None else (self.lowest, self.highest)

    def check_value(self, value: Any, name: str = "") -> Any:
        """Return `value` as it is to be used for the parameter `name` (its own); raises CesError if it is not allowed.

        A whole number will do for a number, any sequence for a list.
        """
        name = name or self.name
        if isinstance(self.default, float) and type(value) is int:
            value = float(value)
        if isinstance(self.default, list) and isinstance(value, Sequence) and not isinstance(value, str):
            value = list(value)
        if type(value) is not type(self.default):
            raise CesError(f"parameter '{name}' is {value!r}; expected a {KINDS[type(self.default)]}")
        if self.one_of and value not in self.one_of:
            raise CesError(f"parameter '{name}' is '{value}'; expected one of {', '.join(self.one_of)}")
        bounds = self.range
        if bounds is not None and isinstance(value, int | float) and not bounds[0] <= value <= bounds[1]:
            raise CesError(f"parameter '{name}' is {value:g}; expected {bounds[0]:g} to {bounds[1]:g}")
        return value


def find_unknown(
    names: Iterable[str], known: Collection[str], groups: Collection[str] = (), owners: Collection[str] = ()
) -> list[str]:
    """Return the `names` that are neither in `known`, nor ROS's own, nor of a group (`GROUP.…`).

    Each of the `owners` has parameters of its own, `OWNER.NAME`, with the names of the others.
    """
    unknown = []
    for name in names:
        first, _, rest = name.partition(".")
        plain = rest if first in owners else name
        if plain not in known and plain.partition(".")[0] not in {*groups, *OF_ROS}:
            unknown.append(name)
    return unknown


EXECUTOR = ParameterSpec(
    "executor",
    "auto",
    "what runs the callbacks: 'events' is rclpy's EventsExecutor, 'single' its SingleThreadedExecutor, 'auto' "
    "events where this rclpy has it",
    one_of=("auto", "events", "single"),
)
MODEL_TOPIC = ParameterSpec(
    "model_topic", "", "latched topic (std_msgs/msg/String) that carries the text of models to load; empty: none"
)
ALLOW_UNCERTIFIED = ParameterSpec("allow_uncertified", False, "run a model whose stability cannot be proved (unsafe)")
