"""The direction of the arrows: what each package may import, and which modules may touch ROS and bag files."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("ces_observer", "ces_identify", "ces_rig", "ces_gap", "ces_cli")
MAY_IMPORT = {
    "ces_observer": set(),
    "ces_identify": {"ces_observer"},
    "ces_rig": {"ces_observer", "ces_identify"},
    "ces_gap": {"ces_observer", "ces_identify"},
    "ces_cli": {"ces_observer", "ces_identify", "ces_rig", "ces_gap"},
}
ROS = {
    "rclpy",
    "launch",
    "launch_ros",
    "ament_index_python",
    "rosidl_runtime_py",
    "rcl_interfaces",
    "builtin_interfaces",
}
NODE_MODULES = {
    "ces_observer.nodes.observer",
    "ces_observer.nodes.observer_parameters",
    "ces_observer.nodes.damper_topics",
    "ces_observer.nodes.message_types",
    "ces_observer.nodes.message_definitions",
    "ces_observer.nodes.executors",
    "ces_observer.nodes.node_clock",
    "ces_observer.nodes.node_parameters",
    "ces_observer.nodes.qos",
    "ces_observer.nodes.signal_parameters",
    "ces_observer.nodes.input_subscriptions",
    "ces_observer.nodes.estimate_output",
    "ces_observer.nodes.diagnostics_output",
    "ces_observer.nodes.model_changes",
    "ces_observer.nodes.black_box_recording",
    "ces_observer.nodes.controller",
    "ces_observer.nodes.controller_model",
    "ces_observer.nodes.controller_parameters",
    "ces_observer.nodes.controller_topics",
    "ces_rig.live.node",
    "ces_rig.live.patched_message",
    "ces_rig.live.topics",
    "ces_cli.identify.node",
}
BAG_MODULES = {
    "ces_identify.recordings.bag_reader",
    "ces_identify.recordings.bag_layout",
    "ces_identify.recordings.bag_message",
    "ces_identify.recordings.bag_storage",
    "ces_identify.recordings.bag_writer",
}
VEHICLE_MCAP_MODULE = "ces_observer.recorder.mcap_file"
MCAP_MODULES = {VEHICLE_MCAP_MODULE, "ces_identify.recordings.mcap_records"}


def modules(*packages: str) -> Iterator[tuple[str, Path]]:
    for package in packages:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            yield name.removesuffix(".__init__"), path


def imported(name: str, path: Path) -> set[str]:
    """Return the full names of all modules that a file imports anywhere, inside functions too."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import; packages here import each other by full name"
            found.add(str(node.module))
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def tops(name: str, path: Path) -> set[str]:
    return {module.partition(".")[0] for module in imported(name, path)}


def is_ros(top: str) -> bool:
    return top in ROS or top.endswith(("_msgs", "_srvs"))


ALL = [pytest.param(name, path, id=name) for name, path in modules(*PACKAGES)]


@pytest.mark.parametrize(("name", "path"), ALL)
def test_packages_import_downward_only(name: str, path: Path) -> None:
    package = name.partition(".")[0]
    assert tops(name, path) & set(PACKAGES) <= MAY_IMPORT[package] | {package}


@pytest.mark.parametrize(("name", "path"), ALL)
def test_only_node_modules_touch_ros(name: str, path: Path) -> None:
    ros = {top for top in tops(name, path) if is_ros(top)}
    assert not ros or name in NODE_MODULES


@pytest.mark.parametrize(("name", "path"), ALL)
def test_only_bag_modules_touch_rosbags_and_mcap(name: str, path: Path) -> None:
    assert "rosbags" not in tops(name, path) or name in BAG_MODULES
    assert "mcap" not in tops(name, path) or name in MCAP_MODULES


@pytest.mark.parametrize(("name", "path"), [p for p in ALL if str(p.id).startswith("ces_observer")])
def test_the_vehicle_needs_the_standard_library_only(name: str, path: Path) -> None:
    foreign = {top for top in tops(name, path) if top not in sys.stdlib_module_names and top != "ces_observer"}
    assert {top for top in foreign if not is_ros(top)} == ({"mcap"} if name == VEHICLE_MCAP_MODULE else set())


def test_the_vehicle_imports_mcap_only_for_a_black_box() -> None:
    tree = ast.parse(dict(modules("ces_observer"))[VEHICLE_MCAP_MODULE].read_text(encoding="utf-8"))
    inside = {
        node for function in ast.walk(tree) if isinstance(function, ast.FunctionDef) for node in ast.walk(function)
    }
    imports = {node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)}
    assert not {ast.unparse(node) for node in imports - inside if "mcap" in ast.unparse(node)}
    assert {ast.unparse(node) for node in imports & inside if "mcap" in ast.unparse(node)}


@pytest.mark.parametrize(("name", "path"), [p for p in ALL if p.id not in NODE_MODULES])
def test_nothing_but_nodes_imports_a_node_module(name: str, path: Path) -> None:
    assert not imported(name, path) & NODE_MODULES


def test_the_listed_modules_exist_and_use_what_they_are_listed_for() -> None:
    paths = dict(modules(*PACKAGES))
    assert all(any(is_ros(top) for top in tops(name, paths[name])) for name in NODE_MODULES)
    assert all("rosbags" in tops(name, paths[name]) for name in BAG_MODULES)
    assert all("mcap" in tops(name, paths[name]) for name in MCAP_MODULES)


@pytest.mark.parametrize("package", ["ces_observer", "ces_identify"])
def test_rooms_import_each_other_without_a_circle(package: str) -> None:
    """A room is a folder of the package, or a module at its top."""
    arrows: dict[str, set[str]] = {}
    for name, path in modules(package):
        room = ".".join(name.split(".")[:2])
        others = {".".join(other.split(".")[:2]) for other in imported(name, path) if other.startswith(f"{package}.")}
        arrows.setdefault(room, set()).update(others - {room})
    while arrows:
        ground = {room for room, others in arrows.items() if not others & set(arrows)}
        assert ground, f"a circle among {', '.join(sorted(arrows))}"
        arrows = {room: others for room, others in arrows.items() if room not in ground}
