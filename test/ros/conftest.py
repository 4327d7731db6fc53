"""What the ROS tests share. Nothing of ROS is imported until a test needs it: without ROS 2 the tests are skipped."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from cpp_package import CppPackage
    from node_process import NodeProcess
    from vehicle import Vehicle

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 99)  # away from whatever else runs on this computer
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "support"))

ROOT = Path(__file__).resolve().parent.parent.parent
NUMBERS = count()
MODULES = {
    "rig": "ces_rig.live.node",
    "observer": "ces_observer.nodes.observer",
    "controller": "ces_observer.nodes.controller",
}


def new_namespace() -> str:
    """Return a namespace that no other test has, of no other run either: two may share a domain."""
    return f"/test{os.getpid()}_{next(NUMBERS)}"


@pytest.fixture(autouse=True)
def _skip_without_executor(request: pytest.FixtureRequest) -> None:
    """Skip a test of the executor of events where this rclpy has none."""
    if getattr(request.node, "callspec", None) and request.node.callspec.params.get("executor") == "events":
        from ces_observer.nodes.rclpy_gaps import EventsExecutor

        if EventsExecutor is None:
            pytest.skip("this rclpy has no EventsExecutor")


@pytest.fixture
def namespace() -> str:
    return new_namespace()


@pytest.fixture
def vehicle(namespace: str) -> Iterator[Vehicle]:
    from vehicle import Vehicle

    with Vehicle(namespace) as vehicle:
        yield vehicle


@pytest.fixture(scope="session")
def model_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from damper_models import plain_damper

    path = tmp_path_factory.mktemp("model") / "model.json"
    plain_damper(max_gap_s=0.3).save(path)
    return path


@pytest.fixture(scope="session")
def banded_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a model with a band."""
    from bands import BAND
    from damper_models import plain_damper

    path = tmp_path_factory.mktemp("model") / "model.json"
    replace(plain_damper(max_gap_s=0.3), band=BAND).save(path)
    return path


@pytest.fixture(scope="session")
def flat_path(banded_path: Path) -> Path:
    """Write the same model as a flat file."""
    from cpp_core import save_flat

    from ces_observer.model import load_model

    return save_flat(load_model(banded_path), banded_path.with_suffix(".ces"))


@pytest.fixture(scope="session")
def package(tmp_path_factory: pytest.TempPathFactory) -> CppPackage:
    """Build the C++ package once for all tests."""
    from cpp_package import CppPackage

    return CppPackage(tmp_path_factory.mktemp("workspace"))


@pytest.fixture
def start(namespace: str, model_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Yield a function that starts the node in the test's namespace with further parameters."""
    yield from starting(namespace, model_path)


@pytest.fixture(scope="module")
def module_vehicle() -> Iterator[Vehicle]:
    """Yield a vehicle for all tests of a module."""
    from vehicle import Vehicle

    with Vehicle(new_namespace()) as vehicle:
        yield vehicle


@pytest.fixture(scope="module")
def module_start(module_vehicle: Vehicle, model_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Yield a function that starts a node for all tests of a module, in the namespace of `module_vehicle`."""
    yield from starting(module_vehicle.namespace, model_path)


def starting(namespace: str, model_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    from node_process import NodeProcess

    started: list[NodeProcess] = []

    def start_node(**parameters: object) -> NodeProcess:
        given = {"model": model_path, **parameters}
        started.append(NodeProcess.from_source(namespace, given))
        return started[-1]

    yield start_node
    for node in started:
        node.kill()


@pytest.fixture(scope="session")
def laid_out(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Lay this checkout out as if it were installed, so that the kernels compiled for it are used."""
    folder = tmp_path_factory.mktemp("prefix")
    share, programs = folder / "share", folder / "lib" / "ces_observer"
    index = share / "ament_index" / "resource_index" / "packages"
    for made in (index, share / "ces_observer", programs):
        made.mkdir(parents=True)
    (index / "ces_observer").touch()
    for name in ("launch", "config"):
        shutil.copytree(ROOT / name, share / "ces_observer" / name)
    for name, module in MODULES.items():
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m {module} "$@"\n', encoding="utf-8")
        program.chmod(0o755)
    return {
        "AMENT_PREFIX_PATH": f"{folder}:{os.environ['AMENT_PREFIX_PATH']}",
        "PYTHONPATH": f"{ROOT}:{os.environ['PYTHONPATH']}",  # launch files import from the package
        "ROS_LOG_DIR": str(folder / "log"),
    }


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Build the package with colcon; return the environment in which it is sourced."""
    if shutil.which("colcon") is None:
        pytest.skip("colcon is missing")
    where = tmp_path_factory.mktemp("workspace")
    source = where / "src" / "ces_observer"
    unwanted = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "install", "log", "out", "bags")
    shutil.copytree(ROOT, source, ignore=unwanted)
    built = subprocess.run(["colcon", "build"], cwd=where, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    script = f". {where}/install/setup.sh && env -0"
    listed = subprocess.run(["sh", "-c", script], capture_output=True, text=True, check=True, env=os.environ)
    return dict(line.split("=", 1) for line in listed.stdout.split("\0") if line)
