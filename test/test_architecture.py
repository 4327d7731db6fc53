"""The direction of the arrows: what each package may import, and which modules may touch ROS and bag files."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("ces_observer", "ces_identify", "ces_rig", "ces_iterate", "ces_gap", "ces_serve", "ces_cli")
MAY_IMPORT = {
    "ces_observer": set(),
    "ces_identify": {"ces_observer"},
    "ces_rig": {"ces_observer", "ces_identify"},
    "ces_gap": {"ces_observer", "ces_identify"},
    "ces_iterate": {"ces_observer", "ces_identify", "ces_rig"},
    "ces_serve": {"ces_observer", "ces_identify"},
    "ces_cli": {"ces_observer", "ces_identify", "ces_rig", "ces_iterate", "ces_gap", "ces_serve"},
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
    "ces_observer.nodes.guarded_node",
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
    "ces_iterate.live.topic_rig",
    "ces_rig.live.node",
    "ces_rig.live.patched_message",
    "ces_rig.live.topics",
    "ces_serve.live.node",
    "ces_cli.identify.node",
}
ROOMS = {  # what each room of a package imports, from the bottom up
    "ces_observer": {
        "arrival_clock": "",
        "clock_watch": "",
        "current_hold": "",
        "errors": "",
        "differentiator": "errors",
        "adaptive_differentiator": "differentiator",
        "json_checks": "errors",
        "json_text": "errors",
        "lazy_names": "",
        "position_queue": "",
        "proof": "",
        "real_time": "errors",
        "recorder": "errors",
        "signals": "errors",
        "band": "json_checks",
        "cdr": "errors signals",
        "structures": "errors json_checks proof",
        "model": "band errors json_checks json_text proof structures",
        "tracker": "adaptive_differentiator differentiator model",
        "estimator": "band model tracker",
        "damper_observer": "current_hold errors estimator model tracker",
        "health": "damper_observer estimator model real_time recorder tracker",
        "control": "errors health model structures",
        "nodes": (
            "arrival_clock cdr clock_watch control current_hold damper_observer errors health model position_queue "
            "real_time recorder signals"
        ),
    },
    "ces_identify": {
        "config_file": "",
        "export": "",
        "jobs": "",
        "numerics": "",
        "schema_files": "",
        "recordings": "config_file numerics",
        "data_export": "recordings",
        "proposal": "recordings",
        "preparation": "numerics recordings",
        "sense": "numerics preparation recordings",
        "typesetting": "",
        "polynomial": "config_file numerics preparation typesetting",
        "progress_file": "polynomial",
        "trained": "numerics polynomial preparation",
        "physical": "numerics polynomial trained",
        "structures": "numerics physical polynomial preparation trained typesetting",
        "simulations": "numerics preparation recordings structures",
        "validation": "numerics polynomial preparation recordings simulations",
        "identification": "polynomial preparation recordings sense structures validation",
        "folds": "identification recordings structures validation",
        "report": "numerics preparation structures typesetting validation",
        "comparison": "numerics preparation recordings report sense simulations typesetting validation",
        "campaign": (
            "comparison config_file identification jobs polynomial recordings report sense structures validation"
        ),
        "characteristics": "numerics preparation recordings report simulations typesetting",
        "cross_fit": "identification numerics polynomial preparation recordings structures",
        "api": (
            "comparison identification polynomial preparation recordings report sense simulations structures validation"
        ),
    },
    "ces_rig": {
        "errors": "",
        "descriptions": "errors",
        "drive": "descriptions errors",
        "nested_numbers": "descriptions",
        "dampers": "descriptions drive errors nested_numbers",
        "sensors": "descriptions",
        "actuated": "dampers drive errors",
        "closed_loop": "dampers drive",
        "experiment": "actuated closed_loop dampers descriptions drive errors sensors",
        "simulation": "dampers errors experiment",
        "withheld": "dampers errors experiment",
        "blind": "dampers drive errors experiment sensors simulation withheld",
        "live": "dampers descriptions drive errors experiment nested_numbers sensors withheld",
    },
    "ces_iterate": {
        "errors": "",
        "commands": "errors",
        "plan": "commands errors",
        "design": "commands errors plan",
        "rigs": "commands errors plan",
        "live": "commands errors rigs",
        "loop": "commands design errors plan rigs",
        "report": "commands loop plan",
        "stroke": "commands errors plan rigs",
    },
    "ces_gap": {
        "derivative": "",
        "errors": "",
        "grid": "errors",
        "plant_map": "derivative",
        "optional_steps": "",
        "progress": "",
        "sensor_noise": "",
        "trace": "derivative errors grid plant_map sensor_noise",
        "effects": "derivative errors grid plant_map trace",
        "baseline": "effects errors progress trace",
        "augmented": "baseline effects errors trace",
        "intake": "baseline effects errors progress trace",
        "inference": "baseline effects intake progress sensor_noise trace",
        "experiment": "baseline effects errors inference trace",
        "where": "baseline errors inference trace",
        "witness": "baseline errors inference intake progress trace",
        "diagnosis": "baseline experiment inference where witness",
        "calibration_map": "diagnosis inference trace",
        "report": "augmented calibration_map diagnosis effects errors experiment inference optional_steps trace",
        "verdict_sentence": "calibration_map diagnosis inference",
        "pipeline": "diagnosis effects experiment inference intake optional_steps progress verdict_sentence where "
        "witness",
        "api": "augmented baseline diagnosis intake pipeline progress report",
        "fleet": "augmented diagnosis effects intake pipeline",
    },
    "ces_serve": {
        "files": "",
        "work": "",
        "live": "",
        "web": "files live work",
    },
    "ces_cli": {
        "terminal": "",
        "bags": "terminal",
        "blind": "terminal",
        "campaign": "terminal",
        "compare": "terminal",
        "diagnose": "terminal",
        "identify": "campaign terminal",
        "iterate": "terminal",
        "main": "terminal",
        "discovery": "identify main terminal",
        "rig": "terminal",
        "ros_program": "main",
        "serve": "terminal",
    },
}
BAG_MODULES = {
    "ces_identify.recordings.topic_fields",
    "ces_identify.recordings.bag_reader",
    "ces_identify.recordings.bag_field_names",
    "ces_identify.recordings.bag_layout",
    "ces_identify.recordings.bag_message",
    "ces_identify.recordings.bag_opening",
    "ces_identify.recordings.bag_storage",
    "ces_identify.recordings.bag_writer",
    "ces_identify.recordings.rosbag1_records",
    "ces_identify.recordings.stored_topic",
}
VEHICLE_MCAP_MODULE = "ces_observer.recorder.mcap_file"
MCAP_MODULES = {VEHICLE_MCAP_MODULE, "ces_identify.recordings.mcap_records", "ces_identify.recordings.mcap_topics"}


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


@pytest.mark.parametrize(("name", "path"), ALL)
def test_only_the_pages_touch_flask(name: str, path: Path) -> None:
    assert not tops(name, path) & {"flask", "werkzeug"} or name.startswith("ces_serve.web.")


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
    for name in NODE_MODULES:
        assert any(is_ros(top) for top in tops(name, paths[name])) or imported(name, paths[name]) & NODE_MODULES
    assert all("rosbags" in tops(name, paths[name]) for name in BAG_MODULES)
    assert all("mcap" in tops(name, paths[name]) for name in MCAP_MODULES)


def rooms_of(package: str) -> dict[str, set[str]]:
    """Return for each room of a package the rooms it imports; a room is a folder, or a module at the top."""
    arrows: dict[str, set[str]] = {}
    for name, path in modules(package):
        room = name.partition(".")[2].partition(".")[0]
        if room:
            parts = (other.split(".") for other in imported(name, path))
            others = {
                part[1] for part in parts if part[0] == package and len(part) > 1 and part[1] in rooms_in(package)
            }
            arrows.setdefault(room, set()).update(others - {room})
    return arrows


def rooms_in(package: str) -> set[str]:
    return {path.stem for path in (ROOT / package).iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}


@pytest.mark.parametrize("package", PACKAGES)
def test_rooms_import_only_the_rooms_below_them(package: str) -> None:
    found, allowed = rooms_of(package), {room: set(below.split()) for room, below in ROOMS[package].items()}
    assert set(found) == set(allowed)
    assert {room: others - allowed[room] for room, others in found.items() if others - allowed[room]} == {}
    assert {room: below - found[room] for room, below in allowed.items() if below - found[room]} == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_rooms_are_listed_from_the_bottom_up(package: str) -> None:
    """A room may use only those listed before it, so there is no circle."""
    before: set[str] = set()
    for room, below in ROOMS[package].items():
        assert set(below.split()) <= before, room
        before.add(room)


def test_bench_has_no_circle() -> None:
    """Scripts import each other by full name, or by file name from their own folder."""
    paths = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in (ROOT / "bench").rglob("*.py")}
    by_stem = {name.rpartition(".")[2]: name for name in paths}
    arrows = {
        name: {by_stem.get(one, one) for one in imported(name, path)} & set(paths) for name, path in paths.items()
    }
    list(TopologicalSorter(arrows).static_order())  # raises CycleError, which names the circle
