"""The observer node's parameters as a table: of the node, of each damper, and what maps its signals."""

from __future__ import annotations

from ces_observer.nodes.parameter_table import ALLOW_UNCERTIFIED, EXECUTOR, MODEL_TOPIC, ParameterSpec

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
OF_THE_NODE = (
    EXECUTOR,
    ParameterSpec(
        "record_dir",
        "~/.ros/ces_observer",
        "folder for bags of the seconds before and after the cost against a measured force has drifted; empty: none",
    ),
    ParameterSpec(
        "record_s",
        15.0,
        "time before the drift that such a bag holds, and a third of it after [s]",
        lowest=1.0,
        highest=300.0,
    ),
    ParameterSpec(
        "record_max_bags", 10, "most bags kept for a damper, the oldest giving way", lowest=1, highest=10_000
    ),
)
OF_A_DAMPER = (
    ParameterSpec(
        "model", "", "path of the model file (model.json); set anew, it is checked and loaded while running", live=True
    ),
    MODEL_TOPIC,
    ALLOW_UNCERTIFIED,
    ParameterSpec(
        "max_age_s",
        0.5,
        "largest difference between a position's stamp and the clock at which its force is published [s]; 0: any",
        live=True,
        lowest=0.0,
        highest=LONGEST_S,
    ),
    ParameterSpec(
        "wait_for_current_s",
        0.0,
        "longest time for which a position is held back until a current stamped no earlier is known [s]; 0: not at all",
        live=True,
        lowest=0.0,
        highest=10.0,
    ),
    ParameterSpec(
        "still_warn_s",
        1.0,
        "time after which a position that has not changed at all is worth a warning: a vehicle at rest, or a stuck "
        "sensor [s]; 0: never",
        live=True,
        lowest=0.0,
        highest=LONGEST_S,
    ),
    ParameterSpec(
        "compare_force", True, "compare the estimate with the measured force on force.topic, while there is one"
    ),
    ParameterSpec(
        "cost_warn_J",
        0.0,
        "running cost J against the measured force from which a new identification is asked for [%]; 0: twice the "
        "model's worst cost in its validation, at least 10",
        live=True,
        lowest=0.0,
        highest=1000.0,
    ),
    ParameterSpec("cost_window_s", 10, "seconds over which the running cost J is taken [s]", lowest=3, highest=3600),
)
# Said for one damper alone: a common name would make the estimates of several look like one.
NAME = ParameterSpec("name", "", "joint name in the estimate; empty: the one in position.field, else the damper's")
