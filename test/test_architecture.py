"""The direction of the arrows, which modules may touch ROS and bag files, and how large files and packages may be.

Each test goes over all modules and names those that break its rule.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Mapping
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MAY_IMPORT = {  # ces_gap and ces_rig never know each other
    "ces_observer": "",
    "ces_data": "ces_observer",
    "ces_report": "ces_observer",
    "ces_identify": "ces_observer ces_data ces_report",
    "ces_rig": "ces_observer ces_data ces_report ces_identify",
    "ces_gap": "ces_observer ces_data ces_report ces_identify",
    "ces_cli": "ces_observer ces_data ces_report ces_identify ces_rig ces_gap",
    "ces": "ces_observer ces_data ces_report ces_identify ces_rig ces_gap ces_cli",
}
ROOMS = {  # folders and modules of each package from the bottom up: each imports only what stands before it
    "ces_observer": (
        "limits arrival_clock errors json_text fields shapes records options current_hold lazy_names proof "
        "reasons tick core flat bank_design signals structures cdr model estimator "
        "damper_observer intake health control nodes"
    ),
    "ces_data": (
        "limits outputs arrays waveforms compilation recording config_file log_formats units findings samples bags "
        "signals_file logs checks mapping tables reading"
    ),
    "ces_report": ("typesetting table drawing shell figure plot"),
    "ces_identify": (
        "limits jobs numerics schema_files prepare polynomial training physical structures options export "
        "simulations characteristics validation comparison identification report campaign scripting"
    ),
    "ces_rig": ("errors limits drive sensors dampers experiments withheld blind live loop"),
    "ces_gap": (
        "limits progress errors grid sensor_noise plant_map trace effects baseline augmented inputs inference "
        "calibrate experiment regions diagnosis report pipeline result_files fleet"
    ),
    "ces": "",
    "ces_cli": ("terminal bags blind_case blind calibrate compare desk diagnose iterate rig identify schema main"),
}
ROS = {
    "rclpy",
    "launch",
    "launch_ros",
    "ament_index_python",
    "rosidl_runtime_py",
    "rcl_interfaces",
    "builtin_interfaces",
    "rosbag2_interfaces",
}
# Modules that may import what the others may not.
NODE_ROOMS = ("ces_observer.nodes", "ces_rig.live", "ces_rig.loop", "ces_cli.identify")
ALLOWED = {
    "rosbags": ("ces_data.bags",),
    "mcap": ("ces_data.bags",),
    "flask": ("ces_cli.desk",),
    "werkzeug": ("ces_cli.desk",),
}
# Hundreds of lines at most, so that growth is a decision: what comes in takes something of equal size out.
MAX_PACKAGE = {
    "ces_observer": 144,
    "ces_data": 116.8,
    "ces_report": 14.3,
    "ces_identify": 195.3,
    "ces_rig": 71.6,
    "ces_gap": 131.5,
    "ces_cli": 65,
    "bench": 72.6,
    "test": 486.8,
}
MAX_FILE = 400  # lines
LONGER_FILES = {  # tables and compiled loops, each a whole
    "ces_rig/dampers/hydraulic/kernel.py",
}


@cache
def modules() -> Mapping[str, Path]:
    """Return the files of all modules by their full names."""
    files = (path for package in MAY_IMPORT for path in sorted((ROOT / package).rglob("*.py")))
    return {".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p for p in files}


@cache
def imported(name: str) -> frozenset[str]:
    """Return the full names of all modules that a module imports anywhere, inside functions too."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(modules()[name].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import; packages here import each other by full name"
            found.add(str(node.module))
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return frozenset(found)


def tops(name: str) -> set[str]:
    return {module.partition(".")[0] for module in imported(name)}


def touches_ros(name: str) -> bool:
    return any(top in ROS or top.endswith(("_msgs", "_srvs")) for top in tops(name))


def is_in(name: str, rooms: tuple[str, ...]) -> bool:
    return any(name == room or name.startswith(room + ".") for room in rooms)


def test_packages_import_downward_only() -> None:
    allowed = {package: {package, *below.split()} for package, below in MAY_IMPORT.items()}
    upward = {name: (tops(name) & set(MAY_IMPORT)) - allowed[name.partition(".")[0]] for name in modules()}
    assert {name: others for name, others in upward.items() if others} == {}


def test_only_node_modules_touch_ros_and_only_nodes_import_them() -> None:
    nodes = {name for name in modules() if touches_ros(name)}
    assert nodes
    assert [name for name in nodes if not is_in(name, NODE_ROOMS)] == []
    assert {n: imported(n) & nodes for n in modules() if imported(n) & nodes and not is_in(n, NODE_ROOMS)} == {}


def test_only_their_rooms_touch_libraries() -> None:
    users = {library: [name for name in modules() if library in tops(name)] for library in ALLOWED}
    assert all(users.values())
    foreign = {library: [name for name in users[library] if not is_in(name, ALLOWED[library])] for library in ALLOWED}
    assert {library: names for library, names in foreign.items() if names} == {}


def test_the_vehicle_needs_the_standard_library_only() -> None:
    known = {*sys.stdlib_module_names, *ROS, "ces_observer"}
    vehicle = [name for name in modules() if name.startswith("ces_observer")]
    foreign = {name: {top for top in tops(name) - known if not top.endswith(("_msgs", "_srvs"))} for name in vehicle}
    assert {name: others for name, others in foreign.items() if others} == {}


def test_the_architecture_page_names_the_rooms_that_there_are() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\* `(\w+)/`", page, flags=re.MULTILINE))
    packages = [package for package in MAY_IMPORT if package != "ces_cli"]  # whose rooms stand in a sentence
    assert named == {path.parent.name for package in packages for path in ROOT.glob(f"{package}/*/__init__.py")}


def test_rooms_import_only_the_rooms_below_them() -> None:
    """A room is a folder, or a module at the top; each uses only those listed before it, so there is no circle."""
    upward = set()
    for package in MAY_IMPORT:
        rooms = ROOMS[package].split()
        parts = (ROOT / package).iterdir()
        found = {path.stem for path in parts if path.suffix == ".py" or (path / "__init__.py").exists()}
        assert found - {"__init__"} == set(rooms), package
        place = {room: i for i, room in enumerate(rooms)}
        for name in modules():
            room = name.removeprefix(package + ".").partition(".")[0]
            if name.startswith(package + "."):
                others = {part[1] for other in imported(name) if (part := other.split("."))[0] == package and part[1:]}
                upward.update(f"{name} -> {o}" for o in others & set(rooms) if o != room and place[o] > place[room])
    assert upward == set()


def test_growth_is_a_decision() -> None:
    """A file has 400 lines at most; a package grows only together with its figure here."""
    lines = {
        path.relative_to(ROOT): path.read_text(encoding="utf-8").count("\n")
        for package in MAX_PACKAGE
        for path in (ROOT / package).rglob("*.py")
    }
    assert {str(path) for path, count in lines.items() if count > MAX_FILE} == LONGER_FILES
    sizes = {package: sum(n for path, n in lines.items() if path.parts[0] == package) for package in MAX_PACKAGE}
    assert {package: size for package, size in sizes.items() if size > 100 * MAX_PACKAGE[package]} == {}


def test_bench_has_no_circle() -> None:
    """Scripts import each other by full name, or by file name from their own folder."""
    paths = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in (ROOT / "bench").rglob("*.py")}
    by_stem = {name.rpartition(".")[2]: name for name in paths}
    arrows: dict[str, set[str]] = {}
    for name, path in paths.items():
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        names |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
        names |= {f"{n.module}.{alias.name}" for n in nodes if isinstance(n, ast.ImportFrom) for alias in n.names}
        arrows[name] = {by_stem.get(one, one) for one in names} & set(paths)
    list(TopologicalSorter(arrows).static_order())  # raises CycleError, which names the circle
