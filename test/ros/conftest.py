"""What the ROS tests share. Nothing of ROS is imported until a test needs it: without ROS 2 the tests are skipped."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from node_process import NodeProcess
    from vehicle import Vehicle

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 99)  # away from whatever else runs on this computer
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "ces_observer"))  # for damper_models

NUMBERS = count()


@pytest.fixture
def namespace() -> str:
    """Return a namespace of the test's own, so that no message of another one is heard."""
    return f"/test{next(NUMBERS)}"


@pytest.fixture
def vehicle(namespace: str) -> Iterator[Vehicle]:
    from vehicle import Vehicle

    with Vehicle(namespace) as vehicle:
        yield vehicle


@pytest.fixture
def model_path(tmp_path: Path) -> Path:
    from damper_models import plain_damper

    path = tmp_path / "model.json"
    plain_damper(max_gap_s=0.3).save(path)
    return path


@pytest.fixture
def start(namespace: str, model_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Yield a function that starts the node in the test's namespace with further parameters."""
    from node_process import NodeProcess

    started: list[NodeProcess] = []

    def start_node(**parameters: object) -> NodeProcess:
        started.append(NodeProcess.from_source(namespace, {"model": model_path, **parameters}))
        return started[-1]

    yield start_node
    for node in started:
        node.kill()
