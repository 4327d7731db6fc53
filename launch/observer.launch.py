"""Start the observer node: ros2 launch ces_observer observer.launch.py model:=/path/model.json."""

from ament_index_python.packages import get_package_share_path
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    parameters = get_package_share_path("ces_observer") / "config" / "observer.yaml"
    return LaunchDescription(
        [
            DeclareLaunchArgument("model", description="path of the model file (model.json)"),
            DeclareLaunchArgument("params_file", default_value=str(parameters), description="parameter file"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of node and topics"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="take time from /clock"),
            observer(),
        ]
    )


def observer() -> Node:
    return Node(
        package="ces_observer",
        executable="observer",
        name="observer",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[
            LaunchConfiguration("params_file"),
            {
                "model": ParameterValue(LaunchConfiguration("model"), value_type=str),
                "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool),
            },
        ],
    )
