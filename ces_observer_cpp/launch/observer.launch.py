"""Start the observer: ros2 launch ces_observer_cpp observer.launch.py model:=/path/model.ces.

Without `container:=NAME` it runs as a program of its own. With it, it runs in that component container, where it
exchanges messages with the other components of the process without DDS: with a leading / in one that runs, else in a
new one. An argument that is empty leaves the parameter file's value.
"""

from ament_index_python.packages import get_package_share_path
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import ComposableNodeContainer, LoadComposableNodes, Node
from launch_ros.descriptions import ComposableNode
from launch_ros.parameter_descriptions import ParameterValue

ESTIMATES = ("", "_band", "_delayed", "_delayed_band")
PACKAGE = "ces_observer_cpp"
PARAMETERS = {
    "model": ("model", str, "absolute path of the flat model file (model.ces)"),
    "position_topic": ("position.topic", str, "topic of the piston position"),
    "current_topic": ("current.topic", str, "topic of the valve current"),
    "autostart": ("autostart", bool, "configure and activate the node; false: a lifecycle manager does"),
    "use_sim_time": ("use_sim_time", bool, "take time from /clock"),
}
OTHERS = {
    "params_file": (str(get_package_share_path(PACKAGE) / "config" / "observer.yaml"), "parameter file"),
    "estimate_topic": ("", "topic of the estimates, with _band and _delayed after it, instead of ~/estimate"),
    "namespace": ("", "namespace of node and topics"),
    "container": ("", "container to load it into; empty: none"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
}


def generate_launch_description() -> LaunchDescription:
    described = {name: ("", meaning) for name, (_, _, meaning) in PARAMETERS.items()} | OTHERS
    arguments = [DeclareLaunchArgument(n, default_value=d, description=m) for n, (d, m) in described.items()]
    return LaunchDescription([*arguments, OpaqueFunction(function=observer)])


def observer(context: LaunchContext) -> list[Node | LoadComposableNodes]:
    settings = context.launch_configurations
    given = [(name, *PARAMETERS[name][:2]) for name in PARAMETERS if settings[name]]
    own = {key: ParameterValue(LaunchConfiguration(name), value_type=kind) for name, key, kind in given}
    namespace, container, topic = settings["namespace"], settings["container"], settings["estimate_topic"]
    common = {"package": PACKAGE, "name": "observer", "namespace": namespace}
    common |= {"parameters": [settings["params_file"], *([own] if own else [])]}
    common |= {"remappings": [(f"~/estimate{end}", topic + end) for end in ESTIMATES if topic]}
    logging = ["--log-level", settings["log_level"]]
    if not container:
        return [Node(executable="observer", output="screen", ros_arguments=logging, **common)]
    within = [{"use_intra_process_comms": True}]
    nodes = [ComposableNode(plugin="ces::ObserverNode", extra_arguments=within, **common)]
    if container.startswith("/"):
        return [LoadComposableNodes(target_container=container, composable_node_descriptions=nodes)]
    kind = {"package": "rclcpp_components", "executable": "component_container", "name": container}
    kind |= {"namespace": namespace, "output": "screen", "ros_arguments": logging}
    return [ComposableNodeContainer(composable_node_descriptions=nodes, **kind)]
