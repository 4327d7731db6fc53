"""Another model for the running C++ observer, by parameter and service; no sample is missing meanwhile."""

from __future__ import annotations

import time
from collections.abc import Iterator
from math import isfinite
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from cpp_core import UNPROVED, save_flat
from cpp_package import CppPackage, missing_tool
from damper_models import damper_with_past, delayed_damper
from vehicle import Vehicle, reliable_inputs, stamp_of, wait

from ces_observer.model import Model

pytestmark = pytest.mark.skipif(bool(missing_tool()), reason=f"{missing_tool()} is missing")

CHANGE = "last change of the model"
MAX_GAP_S = 5.0  # with samples that a busy computer holds up
MAX_LOAD_S = 0.05


def damper(past: float = 0.9) -> Model:
    """Return the test model with another coefficient of its past force, which another digest names."""
    return damper_with_past(past, max_gap_s=MAX_GAP_S)


@pytest.fixture(scope="module")
def driven(module_vehicle: Vehicle, package: CppPackage, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Vehicle]:
    """Yield a vehicle that drives through all tests of this module, and see at their end that no sample is missing."""
    vehicle = module_vehicle
    path = save_flat(damper(), tmp_path_factory.mktemp("models") / "first.ces")
    inputs = reliable_inputs(vehicle.namespace, ["joint_states"])
    given = {"model": path, "max_age_s": 0.0, "current.constant": 0.5, **inputs}
    node = package.start(vehicle.namespace, "observer", given)
    try:
        vehicle.meets_node()
        with vehicle.driving(contiguous=True):
            wait(lambda: bool(vehicle.estimates), "the first estimate")
            yield vehicle
        wait(lambda: stamp_of(vehicle.estimates[-1]) == vehicle.driven[-1], "the last estimate")
        expected = vehicle.driven[vehicle.driven.index(vehicle.stamps()[0]) :]
        assert vehicle.stamps() == expected
        assert len(expected) > 1000
        assert all(isfinite(message.effort[0]) for message in vehicle.estimates)
    finally:
        node.kill()


def runs(vehicle: Vehicle, model: Model) -> None:
    """Wait until diagnostics tell that the node runs the model."""
    vehicle.hears_value("model sha256", model.digest())


def test_a_delay_brings_its_topics_and_its_estimates_come_there_alone(
    vehicle: Vehicle, package: CppPackage, namespace: str, tmp_path: Path
) -> None:
    plain = save_flat(damper(), tmp_path / "plain.ces")
    node = package.start(namespace, "observer", {"model": plain, "max_age_s": 0.0, "current.constant": 0.5})
    late = vehicle.hear_estimates("observer/estimate_delayed")
    try:
        vehicle.meets_node()
        assert vehicle.node.count_publishers("observer/estimate_delayed") == 0
        with vehicle.driving(contiguous=True):
            wait(lambda: bool(vehicle.estimates), "the first estimate")
            model = delayed_damper(0.003, max_gap_s=MAX_GAP_S)
            answer = vehicle.sets("model", str(save_flat(model, tmp_path / "delayed.ces")))
            assert answer.successful and "delayed.ces: accepted; takes over when warmed up" in answer.reason
            wait(lambda: len(late) > 100, "delayed estimates")
            assert vehicle.sets("model", str(plain)).successful
            wait(lambda: vehicle.node.count_publishers("observer/estimate_delayed") == 0, "the topic goes")
            told = vehicle.driven[-1]
            wait(lambda: vehicle.stamps()[-1] > told, "estimates at once again")
        assert not {*vehicle.stamps()} & {stamp_of(message) for message in late[10:-10]}
    finally:
        node.kill()


def test_by_parameter(driven: Vehicle, tmp_path: Path) -> None:
    path = save_flat(damper(0.8), tmp_path / "softer.ces")
    assert driven.sets("model", str(path)).successful
    runs(driven, damper(0.8))
    assert driven.gets("model") == str(path)
    driven.hears_value(CHANGE, f"{path}: has taken over")


def test_it_loads_within_a_few_samples(driven: Vehicle, tmp_path: Path) -> None:
    times = []
    for k in range(10):
        path = save_flat(damper(0.5 + 0.01 * k), tmp_path / f"{k}.ces")
        begun = time.monotonic()
        assert driven.sets("model", str(path)).successful
        times.append(time.monotonic() - begun)
    print("load [ms]:", [round(1e3 * one, 1) for one in times])
    assert min(times) < MAX_LOAD_S
    runs(driven, damper(0.59))


def test_by_service_which_reads_the_same_file_again(driven: Vehicle, tmp_path: Path) -> None:
    path = save_flat(damper(0.75), tmp_path / "model.ces")
    assert driven.sets("model", str(path)).successful
    save_flat(damper(0.7), path)
    answer = driven.reloads.call()
    assert answer.success, answer.message
    assert "takes over when warmed up, after 0.1 s" in answer.message
    runs(driven, damper(0.7))


def test_a_file_that_cannot_be_used_is_refused_at_once(driven: Vehicle, tmp_path: Path) -> None:
    before = driven.gets("model")
    assert "none.ces: no such model file" in driven.sets("model", str(tmp_path / "none.ces")).reason
    path = save_flat(damper(0.65), tmp_path / "broken.ces")
    path.write_bytes(path.read_bytes()[:-100])
    assert "broken.ces: its checksum is wrong" in driven.sets("model", str(path)).reason
    save_flat(damper(0.65), path, UNPROVED)
    assert "its stability is not proved; identify it again" in driven.sets("model", str(path)).reason
    assert "expected the absolute path" in driven.sets("model", "model.ces").reason
    speed = damper_with_past(0.9, motion="speed", motion_noise=0.01)
    assert "the model needs the signal 'speed'" in driven.sets("model", str(save_flat(speed, path))).reason
    assert driven.gets("model") == before


def test_the_service_says_why_it_refuses(driven: Vehicle, tmp_path: Path) -> None:
    path = save_flat(damper(0.85), tmp_path / "worn.ces")
    assert driven.sets("model", str(path)).successful
    runs(driven, damper(0.85))
    path.unlink()
    assert "worn.ces: no such model file" in driven.reloads.call().message
    driven.hears_value(CHANGE, "refused, the old model runs on: ")
    assert all(answer.message for answer in driven.reloads.answers(100))
