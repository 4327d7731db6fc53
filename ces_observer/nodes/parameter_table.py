"""Parameters of nodes as tables: name, default, meaning, range, and whether they can change while the node runs.

It does not use ROS: `node_parameters.declare_table` declares a table; documentation and tests read the same table.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from ces_observer.errors import CesError

Value = bool | int | float | str | list[str] | list[float] | list[int]
KINDS = {bool: "truth value (true or false)", int: "whole number", float: "number", str: "string", list: "list"}
NO_WORDS = [""]  # ROS 2 has no empty list of strings; empty strings are ignored
OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides")


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter; `lowest` and `highest` bound numbers, both included, `one_of` lists the allowed strings."""

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
        """Return the value for the parameter `name` (default: its own); raises CesError if it is not allowed.

        Whole numbers are converted to numbers, sequences to lists.
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
    """Return the `names` that are neither `known`, nor ROS's own, nor in one of the `groups` (`GROUP.…`).

    Each of the `owners` has its own parameters with the same names, `OWNER.NAME`.
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
    "events if this rclpy has it",
    one_of=("auto", "events", "single"),
)
MODEL_TOPIC = ParameterSpec(
    "model_topic", "", "latched topic (std_msgs/msg/String) with the text of models to load; empty: none"
)
ALLOW_UNCERTIFIED = ParameterSpec("allow_uncertified", False, "run a model whose stability cannot be proved (unsafe)")
