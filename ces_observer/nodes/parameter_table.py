"""The parameters of the nodes as tables: common ones, those of the observer and its dampers, those of the controller.

It does not use ROS: `parameters.declare_table` declares a table; documentation and tests read the same table.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from functools import partial
from typing import Any

from ces_observer.control.control_loop import FEEDBACKS
from ces_observer.control.force_controller import Tuning
from ces_observer.errors import CesError
from ces_observer.limits import HealthLimits
from ces_observer.options import Option
from ces_observer.records import record_fields
from ces_observer.signals import FIELDS

TYPES = {bool: "BOOL", int: "INTEGER", float: "DOUBLE", str: "STRING"}  # as in rcl_interfaces/msg/ParameterType
OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides")


def find_unknown(
    names: Iterable[str], known_names: Collection[str], groups: Collection[str] = (), owners: Collection[str] = ()
) -> list[str]:
    """Return the `names` that are neither `known`, nor ROS's own, nor in one of the `groups` (`GROUP.…`).

    Each of the `owners` has its own parameters with the same names, `OWNER.NAME`.
    """
    unknown = []
    for name in names:
        owner, _, own_name = name.partition(".")
        plain = own_name if owner in owners else name
        if plain not in known_names and plain.partition(".")[0] not in {*groups, *OF_ROS}:
            unknown.append(name)
    return unknown


def type_name(spec: Option) -> str:
    """Return ROS's name of the type of a parameter, such as DOUBLE or STRING_ARRAY."""
    return TYPES[spec.kind] + ("_ARRAY" if spec.many else "")


def check_value(spec: Option, name: str, kind: str, value: Any) -> Any:
    """Return a value for the parameter `name`; raises CesError unless it has type and range of `spec`."""
    require_type(name, type_name(spec), kind)
    return spec.check_parameter(value, name)


def require_type(name: str, wanted: str, kind: str) -> None:
    """Raise CesError in the words of rclcpp unless a value has the type of its parameter."""
    if kind == "NOT_SET":
        raise CesError("cannot undeclare a statically typed parameter")
    if kind != wanted:
        types = f"parameter {{{name}}} is of type {{{wanted.lower()}}}, setting it to {{{kind.lower()}}}"
        raise CesError(f"Wrong parameter type, {types} is not allowed.")


def signal_options(signal: str, defaults: Mapping[str, Any]) -> tuple[Option, ...]:
    """Return the parameters SIGNAL.KEY of a signal; those without a default are not set."""
    keys = [key for key in FIELDS if key != "constant" or signal == "current"]
    return tuple(
        Option.from_field(
            FIELDS[key],
            name=f"{signal}.{key}",
            key="",
            make=None,
            default=defaults.get(key),
            meaning=f"{signal}: {FIELDS[key].meaning}",
        )
        for key in keys
    )


# fmt: off
EXECUTOR = Option(
    "executor", "auto",
    "what runs the callbacks: 'single' is rclpy's SingleThreadedExecutor, 'events' its experimental EventsExecutor "
    "with 40 % of that load, 'auto' events if there is one", choices=("auto", "events", "single"))
AUTOSTART = Option(
    "autostart", True, "configure and activate at the start; false: a lifecycle manager or `ros2 lifecycle` does")
BOND = Option("bond_heartbeat_period", 0.1,
              "without autostart: time between the heartbeats on `bond` that nav2's manager asks for, if the package "
              "bond is installed [s]; 0: none", 0.0, 3.0)
ALLOW_UNCERTIFIED = Option("allow_uncertified", False, "run a model whose stability cannot be proved (unsafe)")

IN_USE = "the node is configured; clean it up first"  # why a parameter that is not live cannot be set
DAMPERS = "dampers"
OF_THE_PROCESS = (EXECUTOR.name, DAMPERS)  # cannot change while it runs
DAMPERS_MEANING = (
    "names of the dampers that this node observes, each with parameters NAME.model and so on, and a topic "
    "~/NAME/estimate; not set: one damper without a name")
OF_DAMPERS = Option(DAMPERS, None, DAMPERS_MEANING, kind=str, many=True)
HOUR_S = 3600.0
INPUT_DEPTH = 5000  # messages: 5 s at 1 kHz
tunable = partial(Option, live=True)
OF_THE_NODE = (
    EXECUTOR,
    AUTOSTART,
    BOND,
    Option("input_depth", INPUT_DEPTH,
           "messages that wait in the queue of each input while the node stalls; at least the highest rate times the "
           "longest stall. Full queues lose the oldest", 1, 100_000),
    Option("snapshot_service", "/rosbag2_recorder/snapshot",
           "service of a `ros2 bag record --snapshot-mode` that is called after a drift of the model; empty: none"),
    Option("snapshot_after_s", 5.0, "time from a drift to its snapshot [s]", 0.0, 300.0),
)
OF_A_DAMPER = (
    tunable("model", "", "path of the model file (model.json); a new path is checked and loaded while running"),
    ALLOW_UNCERTIFIED,
    tunable("max_age_s", 0.5,
            "largest difference between a position's stamp and the clock at which its force is published [s]; 0: any",
            0.0, HOUR_S),
    tunable("wait_for_current_s", 0.0,
            "longest time for which a position waits until a current stamped no earlier is known [s]; 0: no waiting",
            0.0, 10.0),
    tunable("still_warn_s", HealthLimits.STILL_S,
            "time without any change of position after which a warning is given: vehicle at rest, or stuck sensor [s]; "
            "0: never", 0.0, HOUR_S),
    tunable("cost_warn_J", 0.0,
            "running cost J against the measured force above which the model has drifted [%]; 0: twice the worst "
            "validation cost of the model, at least 10", 0.0, 1000.0),
    Option("cost_window_s", 10, "time over which the running cost J is computed [s]", 3, 3600),
)
# Never common to several dampers: their estimates would look like one.
NAME = Option("name", "", "joint name in the estimate; empty: the one in position.field, else the damper's")

FROM_THE_MODEL = -1.0
SPEEDS, FORCES = "curve.speeds_m_s", "curve.forces_N"
CURVE = (
    tunable(SPEEDS, [-1.0, -0.6, -0.3, -0.1, 0.0, 0.1, 0.3, 0.6, 1.0], "desired curve: rising speeds [m/s]"),
    tunable(FORCES, [-2900.0, -2300.0, -1500.0, -700.0, 0.0, 380.0, 750.0, 1100.0, 1500.0],
            "desired curve: the force at each speed [N], with the sign of the speed"),
)
FIXED = (
    EXECUTOR,
    AUTOSTART,
    BOND,
    tunable("model", "",
            "path of the model file (model.json) that the observer uses, too; its inverse is fed forward. If it is "
            "changed while running, the new model is checked and adopted"),
    ALLOW_UNCERTIFIED,
    Option("estimate_topic", "observer/estimate", "topic of the estimates (JointState: velocity, effort)"),
    Option("joint", "", "joint of the estimates to control; empty: the first in the message"),
    Option("force_topic", "measured_force", "topic of the measured force (WrenchStamped: wrench.force.z)"),
)
LOOP = (
    tunable("feedback", "estimate", "which force is fed back", choices=FEEDBACKS),
    tunable("max_age_s", 0.05,
            "largest difference between an estimate's stamp and the clock at which the estimate is used [s]; 0: any",
            0.0, HOUR_S),
)
OF_THE_MODEL = {"default": FROM_THE_MODEL, "low": FROM_THE_MODEL}
TUNING = tuple(
    Option.from_field(declared, live=True, **(OF_THE_MODEL if declared.name == "valve_lag_s" else {}))
    for declared in record_fields(Tuning).values()
)
# fmt: on
OF_THE_CONTROLLER = (*FIXED, *LOOP, *TUNING, *CURVE)
