"""The observer node's parameters as a table: of the node, of each damper, and of its signals."""

from __future__ import annotations

from ces_observer.nodes.parameter_table import ALLOW_UNCERTIFIED, EXECUTOR, MODEL_TOPIC, ParameterSpec
from ces_observer.real_time import ALL_PROCESSORS, MAX_PRIORITY

DAMPERS = "dampers"
DAMPERS_MEANING = (
    "names of the dampers that this node observes, each with parameters NAME.model and so on, and a topic "
    "~/NAME/estimate; not set: one damper without a name"
)
SIGNAL_KEYS = {
    "topic": "topic; a relative name is resolved in the node's namespace",
    "type": "message type, such as sensor_msgs/msg/JointState",
    "field": "path to the number in the message, such as data, wrench.force.z or position[rear_damper]",
    "scale": "value in SI units = scale * number + offset",
    "offset": "value in SI units = scale * number + offset",
    "delay": "[s] by how much later than measured the numbers are stamped; stamps are moved back by it",
}
LONGEST_S = 3600.0
INPUT_DEPTH = 5000  # messages: 5 s at 1 kHz
OF_THE_NODE = (
    EXECUTOR,
    ParameterSpec(
        "input_depth",
        INPUT_DEPTH,
        "messages that wait in the queue of each input while the node stalls; at least the highest rate times the "
        "longest stall. Full queues lose the oldest. About 0.3 kB of memory each, used only in a stall",
        lowest=1,
        highest=100_000,
    ),
    ParameterSpec(
        "realtime_priority",
        0,
        "priority of the node under SCHED_FIFO, that of its DDS threads is one higher; 0: ordinary scheduling",
        lowest=0,
        highest=MAX_PRIORITY,
    ),
    ParameterSpec("cpu_affinity", ALL_PROCESSORS, "processors that the node may use, such as [2, 3]; [-1]: all"),
    ParameterSpec("lock_memory", False, "keep the node's memory from being swapped out"),
    ParameterSpec(
        "record_dir",
        "~/.ros/ces_observer",
        "folder for bags of the seconds before and after a drift of the model; empty: none",
    ),
    ParameterSpec(
        "record_s",
        15.0,
        "recorded time before a drift [s]; a third of it is recorded after the drift",
        lowest=1.0,
        highest=300.0,
    ),
    ParameterSpec(
        "record_max_bags",
        10,
        "maximum number of bags for each damper; the oldest are removed",
        lowest=1,
        highest=10_000,
    ),
)
OF_A_DAMPER = (
    ParameterSpec(
        "model", "", "path of the model file (model.json); a new path is checked and loaded while running", live=True
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
        "longest time for which a position waits until a current stamped no earlier is known [s]; 0: no waiting",
        live=True,
        lowest=0.0,
        highest=10.0,
    ),
    ParameterSpec(
        "still_warn_s",
        1.0,
        "time without any change of position after which a warning is given: vehicle at rest, or stuck sensor [s]; "
        "0: never",
        live=True,
        lowest=0.0,
        highest=LONGEST_S,
    ),
    ParameterSpec(
        "compare_force", True, "compare the estimate with the measured force on force.topic, if there is one"
    ),
    ParameterSpec(
        "cost_warn_J",
        0.0,
        "running cost J against the measured force above which the model has drifted [%]; 0: twice the worst "
        "validation cost of the model, at least 10",
        live=True,
        lowest=0.0,
        highest=1000.0,
    ),
    ParameterSpec("cost_window_s", 10, "time over which the running cost J is computed [s]", lowest=3, highest=3600),
)
# Never common to several dampers: their estimates would look like one.
NAME = ParameterSpec("name", "", "joint name in the estimate; empty: the one in position.field, else the damper's")
