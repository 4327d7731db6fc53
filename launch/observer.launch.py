"""Start the observer node: ros2 launch ces_observer observer.launch.py model:=/path/model.json.

An argument that is not set leaves the parameter file's value.
"""

from ament_index_python.packages import get_package_share_path
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from ces_observer.nodes.launch_arguments import check_files, check_names

PARAMETERS = {
    "model": ("path of the model file (model.json)", str),
    "executor": ("what runs the callbacks: auto, events or single", str),
    "use_sim_time": ("take time from /clock", bool),
}


def generate_launch_description() -> LaunchDescription:
    shipped = get_package_share_path("ces_observer") / "config" / "observer.yaml"
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=str(shipped), description="parameter file"),
            *(
                DeclareLaunchArgument(name, default_value="", description=meaning)
                for name, (meaning, _) in PARAMETERS.items()
            ),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of node and topics"),
            DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal"),
            OpaqueFunction(function=observer),
        ]
    )


def observer(context: LaunchContext) -> list[Node]:
    check_names(__file__, [*PARAMETERS, "params_file", "namespace", "log_level"])
    check_files({"params_file": context.launch_configurations["params_file"]})
    own = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, (_, kind) in PARAMETERS.items()
        if context.launch_configurations[name]
    }
    node = Node(
        package="ces_observer",
        executable="observer",
        name="observer",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[LaunchConfiguration("params_file"), own],
        ros_arguments=["--log-level", LaunchConfiguration("log_level")],
    )
    return [node]
