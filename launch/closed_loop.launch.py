"""Close the loop on the virtual rig: rig, observer and controller.

ros2 launch ces_observer closed_loop.launch.py
ros2 launch ces_observer closed_loop.launch.py drive:=vehicle feedback:=none
ros2 launch ces_observer closed_loop.launch.py use_sim_time:=true real_time_factor:=0.0
With a factor of 0 each sample waits for the command that answers it: the loop runs in lockstep, as fast as possible.
All names are relative: PushRosNamespace and SetRemap of an including launch file move them (docs/live.md).
"""

from typing import Any

from ament_index_python.packages import get_package_share_path
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

SHARE = get_package_share_path("ces_observer")
ANSWER_S = 2.0  # longest wait in lockstep
SILENCE_S = 10.0  # in lockstep, until the controller commands the safe current unasked: longer than that wait
ARGUMENTS = {
    "model": (SHARE / "config" / "models" / "sample.json", "model file of observer and controller"),
    "namespace": ("", "namespace of nodes and topics"),
    "autostart": ("true", "false: a lifecycle manager configures and activates observer and controller"),
    "use_sim_time": ("false", "let the rig publish /clock, and all nodes use it"),
    "real_time_factor": ("1.0", "with use_sim_time: simulated over real time; 0.0: in lockstep with the controller"),
    "drive": ("script", "what moves the damper: script, vehicle or set_points"),
    "stroke": ("noise", "drive script: rest, sine, sweep, noise or triangle"),
    "amplitude_m": ("0.02", "drive script: largest distance from mid-stroke"),
    "road_class": ("C", "drive vehicle: ISO 8608 road class"),
    "feedback": ("estimate", "force that is fed back: estimate, measured or none"),
    "rig_params": (SHARE / "config" / "rig_live.yaml", "parameter file of the rig"),
    "observer_params": (SHARE / "config" / "observer.yaml", "parameter file of the observer"),
    "controller_params": (SHARE / "config" / "controller.yaml", "parameter file of the controller"),
}


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=str(default), description=meaning)
        for name, (default, meaning) in ARGUMENTS.items()
    ]
    model = {
        "model": argument_value("model"),
        "autostart": argument_value("autostart", bool),
        "use_sim_time": argument_value("use_sim_time", bool),
    }
    rig = {
        "drive": argument_value("drive"),
        "script.kind": argument_value("stroke"),
        "script.amplitude_m": argument_value("amplitude_m", float),
        "vehicle.road_class": argument_value("road_class"),
        "publish_clock": argument_value("use_sim_time", bool),
        "real_time_factor": argument_value("real_time_factor", float),
        "answer_s": ANSWER_S,
    }
    return LaunchDescription(
        [
            *declared,
            node("rig", rig),
            node("observer", model),
            OpaqueFunction(function=make_controller, args=[{**model, "feedback": argument_value("feedback")}]),
        ]
    )


def make_controller(context: LaunchContext, parameters: dict[str, Any]) -> list[Node]:
    """Return the controller; in lockstep it waits for the rig rather than the rig for it."""
    given = context.launch_configurations
    simulated = given["use_sim_time"].lower() == "true"
    in_lockstep = simulated and given["real_time_factor"].strip("0") in ("", ".")
    return [node("controller", {**parameters, **({"timeout_s": SILENCE_S} if in_lockstep else {})})]


def node(name: str, parameters: dict[str, Any]) -> Node:
    return Node(
        package="ces_observer",
        executable=name,
        name=name,
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[LaunchConfiguration(f"{name}_params"), parameters],
    )


def argument_value(argument: str, kind: type = str) -> ParameterValue:
    return ParameterValue(LaunchConfiguration(argument), value_type=kind)
