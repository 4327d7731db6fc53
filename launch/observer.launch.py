"""Start the observer node: ros2 launch ces_observer observer.launch.py model:=/path/model.json.

An argument that is not set leaves the parameter file's value. docs/live.md shows it included in a launch file of a
vehicle, with other namespaces and topics, and driven by a lifecycle manager.
"""

from ament_index_python.packages import get_package_share_path
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

ESTIMATES = ("", "_band", "_delayed", "_delayed_band")
PARAMETERS = {  # by argument: the parameter, its type, and what it means
    "model": ("model", str, "path of the model file (model.json)"),
    "position_topic": ("position.topic", str, "topic of the position"),
    "current_topic": ("current.topic", str, "topic of the current"),
    "force_topic": ("force.topic", str, "topic of a measured force"),
    "executor": ("executor", str, "what runs the callbacks: auto, events or single"),
    "autostart": ("autostart", bool, "false: a lifecycle manager configures and activates the node"),
    "use_sim_time": ("use_sim_time", bool, "take time from /clock"),
}
OTHERS = {
    "params_file": (get_package_share_path("ces_observer") / "config" / "observer.yaml", "parameter file"),
    "estimate_topic": ("", "topic of the estimates of a single damper, with _band and _delayed after it"),
    "namespace": ("", "namespace of node and topics"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
}


def generate_launch_description() -> LaunchDescription:
    arguments = {**{name: ("", meaning) for name, (_, _, meaning) in PARAMETERS.items()}, **OTHERS}
    declared = [
        DeclareLaunchArgument(name, default_value=str(default), description=meaning)
        for name, (default, meaning) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=observer)])


def observer(context: LaunchContext) -> list[LifecycleNode]:
    given = context.launch_configurations
    topic = given["estimate_topic"]
    own = {
        parameter: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, (parameter, kind, _) in PARAMETERS.items()
        if given[name]
    }
    node = LifecycleNode(
        package="ces_observer",
        executable="observer",
        name="observer",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[LaunchConfiguration("params_file"), own],
        remappings=[(f"~/estimate{end}", topic + end) for end in ESTIMATES if topic],
        ros_arguments=["--log-level", LaunchConfiguration("log_level")],
    )
    return [node]
