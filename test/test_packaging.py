"""The two installations: what setup.py gives to pip and to colcon, and that it agrees with package.xml."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from ces_cli.main import PROGRAMS
from ces_cli.ros_program import DESK
from ces_data.signals_file import load_signals
from ces_observer import __version__
from ces_observer.signals import Signals

ROOT = Path(__file__).resolve().parent.parent
COLLECT = """
import sys, setuptools
{before}
KEYS = ("version", "entry_points", "packages", "data_files", "extras_require")
setuptools.setup = lambda **given: print(repr({{key: given[key] for key in KEYS}}))
exec(compile(open("setup.py").read(), "setup.py", "exec"), {{"__file__": "setup.py", "__name__": "__main__"}})
"""


def arguments(before: str) -> dict[str, object]:
    """Return some of what setup.py hands to setuptools, as a build that has run `before` would see it."""
    code = COLLECT.format(before=before)
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    return dict(ast.literal_eval(done.stdout))


def programs(given: dict[str, object]) -> dict[str, str]:
    scripts = dict(given["entry_points"])["console_scripts"]  # type: ignore[call-overload]
    return dict(script.split(" = ") for script in scripts)


@pytest.fixture(scope="module", autouse=True)
def _setuptools() -> None:
    pytest.importorskip("setuptools")


def test_pip_gets_one_program() -> None:
    assert programs(arguments("import setuptools.build_meta")) == {"ces": "ces_cli.main:main"}


def test_colcon_gets_the_nodes_and_every_program() -> None:
    found = programs(arguments(""))
    for node in ("observer", "controller"):
        assert found.pop(node) == f"ces_observer.nodes.{node}:main"
    assert found == dict.fromkeys(PROGRAMS, "ces_cli.ros_program:main")


def test_packages_are_the_seven_without_tests() -> None:
    found = arguments("")["packages"]
    assert isinstance(found, list)
    assert {"ces_observer", "ces_identify", "ces_rig", "ces_gap", "ces_iterate", "ces_serve", "ces_cli"} <= set(found)
    assert all(name.startswith("ces_") for name in found)


def test_version_is_one() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    assert manifest.findtext("version") == __version__ == arguments("")["version"]


def depends(vehicle: str) -> set[str]:
    """Return what rosdep installs with this CES_VEHICLE: package.xml's dependencies whose condition (REP 149) holds."""
    tags = [tag for tag in ElementTree.parse(ROOT / "package.xml").getroot() if tag.tag.endswith("_depend")]
    assert {tag.get("condition", "") for tag in tags} == {"", "$CES_VEHICLE != 1"}
    return {str(tag.text) for tag in tags if vehicle != "1" or not tag.get("condition")}


def test_a_vehicle_gets_what_the_nodes_import_and_no_more() -> None:
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "ces_observer").rglob("*.py")]
    nodes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ImportFrom | ast.Import)]
    names = {getattr(node, "module", None) or node.names[0].name for node in nodes}
    imported = {name.partition(".")[0] for name in names} - {"ces_observer", *sys.stdlib_module_names}
    by_name = {"rosbag2_interfaces", "rosgraph_msgs", "lifecycle_msgs", "launch", "launch_ros", "ros2launch"}
    assert depends("1") == imported | by_name
    desk = depends("") - depends("1")
    assert all(any(library in key for key in desk) for library in (*DESK, "flask", "pytest"))


def test_package_files_are_where_ament_looks() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    assert manifest.get("format") == "3"
    assert manifest.findtext("name") == "ces_observer"
    assert manifest.findtext("export/build_type") == "ament_python"
    assert (ROOT / "resource" / "ces_observer").exists()


def test_share_gets_parameters_layouts_launch_files_and_policies() -> None:
    given = [(Path(folder), [Path(file) for file in found]) for folder, found in arguments("")["data_files"]]  # type: ignore[attr-defined]
    share = Path("share/ces_observer")
    shared = {file for folder, found in given for file in found if folder == share / file.parent}
    there = {path.relative_to(ROOT) for folder in ("config", "launch") for path in (ROOT / folder).rglob("*.*")}
    configured = {path for path in shared if path.parts[0] in ("config", "launch")}
    assert configured == {path for path in there if path.suffix != ".pyc"}
    assert Path("config/import/utfsm_mr.yaml") in shared


def test_a_build_makes_the_schemas_that_shared_files_name(tmp_path: Path) -> None:
    """In the package, and beside the parameter files in share/ces_observer, at the path that their first lines name."""
    words = ["--quiet", "build", "--build-base", tmp_path / "build", "install_data", "--install-dir", tmp_path / "root"]
    subprocess.run([sys.executable, "setup.py", *map(str, words)], cwd=ROOT, capture_output=True, check=True)
    assert (tmp_path / "build" / "lib" / "ces_identify" / "schemas" / "signals.json").is_file()
    shared = list((tmp_path / "root" / "share" / "ces_observer" / "config").rglob("*.yaml"))
    assert shared
    for file in shared:
        first = file.read_text(encoding="utf-8").partition("\n")[0]
        if "$schema=" in first:
            assert (file.parent / first.partition("$schema=")[2]).is_file(), file


def test_the_extra_formats_holds_those_of_all_formats() -> None:
    extras = arguments("")["extras_require"]
    assert isinstance(extras, dict)
    single = [library for extra in ("mdf", "mat73", "can", "parquet") for library in extras[extra]]
    assert sorted(extras["formats"]) == sorted(single)
    assert set(single) <= set(extras["dev"])


def test_shipped_signals_are_the_defaults() -> None:
    defaults = dict(Signals.from_mapping({}, "defaults").by_name)
    for name in ("signals.yaml", "observer.yaml"):
        assert dict(load_signals(ROOT / "config" / name).by_name) == defaults, name
