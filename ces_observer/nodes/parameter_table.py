"""The observer node's parameters as a table: name, default, meaning, range, and whether they can change while it runs.

Knows no ROS, so that the node declares them, and documentation and tests read them, from one place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ces_observer.errors import CesError

Value = bool | int | float | str
DAMPERS = "dampers"
DAMPERS_MEANING = (
    "names of the dampers observed by this node, each with parameters NAME.model and so on, and a topic "
    "~/NAME/estimate; not set: one damper without a name"
)
SIGNAL_KEYS = {
    "topic": "topic; a relative name is resolved in the node's namespace",
    "type": "message type, such as sensor_msgs/msg/JointState",
    "field": "path to the number in the message, such as data, wrench.force.z or position[rear_damper]",
    "scale": "value in SI units = scale * number + offset",
    "offset": "value in SI units = scale * number + offset",
}
LONGEST_S = 3600.0
KINDS = {bool: "truth value (true or false)", int: "whole number", float: "number", str: "text"}


@dataclass(frozen=True)
class Spec:
    """One parameter; `lowest` and `highest` bound numbers, both included, `one_of` lists what a text may be."""

    name: str
    default: Value
    meaning: str
    live: bool = False
    lowest: float | None = None
    highest: float | None = None
    one_of: tuple[str, ...] = ()

    @property
    def range(self) -> tuple[float, float] | None:
        """Lowest and highest number allowed, if it has bounds."""
        return None if self.lowest is None or self.highest is None else (self.lowest, self.highest)

    def checked(self, value: Any, name: str) -> Any:
        """Return `value` as it is to be used for the parameter `name`; raises CesError if it is none of the allowed."""
        if isinstance(self.default, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(self.default):
            raise CesError(f"parameter '{name}' is {value!r}; expected a {KINDS[type(self.default)]}")
        if self.one_of and value not in self.one_of:
            raise CesError(f"parameter '{name}' is '{value}'; expected one of {', '.join(self.one_of)}")
        bounds = self.range
        if bounds is not None and isinstance(value, int | float) and not bounds[0] <= value <= bounds[1]:
            raise CesError(f"parameter '{name}' is {value:g}; expected {bounds[0]:g} to {bounds[1]:g}")
        return value


EXECUTOR = Spec(
    "executor",
    "auto",
    "what runs the callbacks: 'events' is rclpy's EventsExecutor, 'single' its SingleThreadedExecutor, 'auto' "
    "events where this rclpy has it",
    one_of=("auto", "events", "single"),
)
MODEL_TOPIC = Spec(
    "model_topic", "", "latched topic (std_msgs/msg/String) that carries the text of models to load; empty: none"
)
ALLOW_UNCERTIFIED = Spec("allow_uncertified", False, "run a model whose stability cannot be proved (unsafe)")
OF_THE_NODE = (
    EXECUTOR,
    Spec(
        "record_dir",
        "~/.ros/ces_observer",
        "folder for bags of the seconds before and after the cost against a measured force has drifted; empty: none",
    ),
    Spec(
        "record_s",
        15.0,
        "time before the drift that such a bag holds, and a third of it after [s]",
        lowest=1.0,
        highest=300.0,
    ),
    Spec("record_max_bags", 10, "most bags kept for a damper, the oldest giving way", lowest=1, highest=10_000),
)
OF_A_DAMPER = (
    Spec("model", "", "path of the model file (model.json); set anew, it is checked and loaded while running", True),
    MODEL_TOPIC,
    ALLOW_UNCERTIFIED,
    Spec(
        "max_age_s",
        0.5,
        "largest difference between a position's stamp and the clock at which its force is published [s]; 0: any",
        live=True,
        lowest=0.0,
        highest=LONGEST_S,
    ),
    Spec(
        "wait_for_current_s",
        0.0,
        "longest time for which a position is held back until a current stamped no earlier is known [s]; 0: not at all",
        live=True,
        lowest=0.0,
        highest=10.0,
    ),
    Spec(
        "still_warn_s",
        1.0,
        "time after which a position that has not changed at all is worth a warning: a vehicle at rest, or a stuck "
        "sensor [s]; 0: never",
        live=True,
        lowest=0.0,
        highest=LONGEST_S,
    ),
    Spec("compare_force", True, "compare the estimate with the measured force on force.topic, while there is one"),
    Spec(
        "cost_warn_J",
        0.0,
        "running cost J against the measured force from which a new identification is asked for [%]; 0: twice the "
        "model's worst cost in its validation, at least 10",
        live=True,
        lowest=0.0,
        highest=1000.0,
    ),
    Spec("cost_window_s", 10, "seconds over which the running cost J is taken [s]", lowest=3, highest=3600),
)
# Said for one damper alone: a common name would make the estimates of several look like one.
NAME = Spec("name", "", "joint name in the estimate; empty: the one in position.field, else the damper's")
