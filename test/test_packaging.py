"""The two installations: what setup.py gives to pip and to colcon, and that it agrees with package.xml."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from xml.etree import ElementTree

import pytest

from ces_cli.main import DESK, PROGRAMS
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
    assert found == dict.fromkeys(PROGRAMS, "ces_cli.main:run_for_ros")


def test_packages_are_ours_without_tests() -> None:
    found = arguments("")["packages"]
    assert isinstance(found, list)
    assert {"ces", "ces_observer", "ces_identify", "ces_rig", "ces_gap", "ces_cli"} <= set(found)
    assert all(name.partition(".")[0] == "ces" or name.startswith("ces_") for name in found)


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
    by_name = {
        "python3-dev",
        "rosbag2_interfaces",
        "rosgraph_msgs",
        "lifecycle_msgs",
        "launch",
        "launch_ros",
        "ros2launch",
    }
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
    assert list((tmp_path / "build").glob("lib*/ces_identify/schemas/signals.json"))
    shared = list((tmp_path / "root" / "share" / "ces_observer" / "config").rglob("*.yaml"))
    assert shared
    for file in shared:
        first = file.read_text(encoding="utf-8").partition("\n")[0]
        if "$schema=" in first:
            assert (file.parent / first.partition("$schema=")[2]).is_file(), file


def build(folder: Path, **variables: str) -> tuple[str, list[Path]]:
    """Return what `setup.py build_ext` says, and the compiled cores that it makes."""
    places = ["--build-lib", str(folder / "lib"), "--build-temp", str(folder / "temp")]
    words, settings = [sys.executable, "setup.py", "--quiet", "build_ext", *places], {**os.environ, **variables}
    done = subprocess.run(words, cwd=ROOT, env=settings, capture_output=True, text=True, check=True)
    return done.stderr, list(folder.glob("lib/ces_observer/_tick*"))


@pytest.mark.needs("cc")
def test_a_build_compiles_the_core_of_this_source(tmp_path: Path) -> None:
    """Beside the source in the build folder, where it is found, and used."""
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        pytest.skip("Python.h is missing; install it: sudo apt install python3-dev")
    _, libraries = build(tmp_path)
    assert len(libraries) == 1
    shutil.copytree(ROOT / "ces_observer", tmp_path / "ces_observer", ignore=shutil.ignore_patterns("_tick*"))
    libraries[0].rename(tmp_path / "ces_observer" / libraries[0].name)
    describe = "from ces_observer import core; print(core.description())"
    clean = {key: value for key, value in os.environ.items() if key not in ("CES_PLAIN_TICK", "PYTHONPATH")}
    words = [sys.executable, "-c", describe]
    done = subprocess.run(words, cwd=tmp_path, env=clean, capture_output=True, text=True, check=True)
    assert done.stdout == "compiled core\n"
    assert not list(ROOT.rglob("ces_core.c"))


def test_a_build_without_a_compiler_goes_on_without_the_core(tmp_path: Path) -> None:
    said, libraries = build(tmp_path, CC="false")
    assert not libraries
    assert "no compiled core, for want of a C compiler or Python.h: the tick runs in Python" in said.splitlines()


def test_the_extra_formats_holds_those_of_all_formats() -> None:
    extras = arguments("")["extras_require"]
    assert isinstance(extras, dict)
    single = [library for extra in ("mdf", "mat73", "can", "tdms", "parquet") for library in extras[extra]]
    assert sorted(extras["formats"]) == sorted(single)
    assert set(single) <= set(extras["dev"])


def test_shipped_signals_are_the_defaults() -> None:
    defaults = dict(Signals.from_mapping({}, "defaults").by_name)
    for name in ("signals.yaml", "observer.yaml"):
        assert dict(load_signals(ROOT / "config" / name).by_name) == defaults, name
