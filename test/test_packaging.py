"""The two installations: what setup.py gives to pip and to colcon, and that it agrees with package.xml."""

from __future__ import annotations

import ast
import os
import re
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


def depends(manifest: Path, *, vehicle: bool = False) -> set[str]:
    """Return what rosdep installs, on a vehicle with CES_VEHICLE=1: dependencies whose condition (REP 149) holds."""
    tags = [tag for tag in ElementTree.parse(manifest).getroot() if tag.tag.endswith("depend")]
    conditions = {tag.get("condition", "") for tag in tags}
    assert conditions <= {"", "$CES_VEHICLE != 1", "$CES_ROS2_CONTROL == 1"}
    return {str(tag.text) for tag in tags if not (vehicle and tag.get("condition"))}


def imports(*folders: str) -> set[str]:
    """Return the packages that the Python files in these folders import, without the standard library and our own."""
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    found = [node for path in paths for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))]
    names = [one.name for node in found if isinstance(node, ast.Import) for one in node.names]
    names += [node.module or "" for node in found if isinstance(node, ast.ImportFrom)]
    ours = {path.stem for path in (ROOT / "test").rglob("*.py")} | {"bench", "ces", "test"}
    top = {name.partition(".")[0] for name in names} - ours - set(sys.stdlib_module_names)
    return {name for name in top if not name.startswith("ces_")}


def test_a_vehicle_gets_what_nodes_and_launch_files_import_and_no_more() -> None:
    vehicle = depends(ROOT / "package.xml", vehicle=True)
    assert vehicle == imports("ces_observer", "launch") | {"python3-dev", "ros2launch"}
    desk = depends(ROOT / "package.xml") - vehicle
    assert all(any(library in key for key in desk) for library in (*DESK, "flask", "pytest"))


def test_the_ros_tests_get_what_they_import_and_run() -> None:
    paths = [path.read_text(encoding="utf-8") for path in (ROOT / "test" / "ros").glob("*.py")]
    programs = {f"ros2{word}" for text in paths for word in re.findall(r'\["ros2", "(\w+)"', text)}
    named = depends(ROOT / "package.xml")
    needed = imports("test/ros", "ces_rig/live") | programs
    assert [name for name in needed if not {name, f"python3-{name}"} & named] == []


def test_the_cpp_package_names_what_it_includes_and_imports() -> None:
    package = ROOT / "ces_observer_cpp"
    texts = [path.read_text(encoding="utf-8") for path in (package / "src").rglob("*.[hc]pp")]
    included = {name for text in texts for name in re.findall(r"#include <(\w+)/", text)} - {package.name}
    assert included | imports(f"{package.name}/launch") <= depends(package / "package.xml")
    assert (package / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()


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
