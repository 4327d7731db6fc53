"""The C++ observer as a managed node."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from cpp_core import save_flat
from cpp_package import CppPackage, missing_tool
from damper_models import plain_damper
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from node_process import NodeProcess
from patience import PATIENCE_S
from rclpy.qos import QoSReliabilityPolicy
from sensor_msgs.msg import Temperature
from vehicle import PROMISES, STAMPED_CURRENT, Vehicle, reliable_inputs, wait

pytestmark = pytest.mark.skipif(bool(missing_tool()), reason=f"{missing_tool()} is missing")

UNCONFIGURED = "unconfigured: configure the node to estimate"
FAILING_CLOCK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <string.h>
#include <unistd.h>
int rcl_clock_get_now(int * clock, long * now)
{
  Dl_info caller;
  dladdr(__builtin_return_address(0), &caller);
  if (*clock == 1 && strstr(caller.dli_fname, "librclcpp") && access(FAILS, F_OK) == 0) {return 1;}
  return ((int (*)(int *, long *))dlsym(RTLD_NEXT, "rcl_clock_get_now"))(clock, now);
}
"""  # while the file FAILS is there, rclcpp cannot read ROS time (clock 1), and each sample fails


LONG_S = 10.0  # for which a model bridges lost samples


def compile_preload(source: str, where: Path, *words: str) -> dict[str, str]:
    """Compile a library that replaces functions of the C++ observer; return the variable that preloads it."""
    library = where / "preload.so"
    command = ["cc", "-shared", "-fPIC", *words, "-x", "c", "-", "-o", str(library), "-ldl"]
    subprocess.run(command, input=source, text=True, check=True)
    return {"LD_PRELOAD": str(library)}


@pytest.fixture
def start_cpp(namespace: str, package: CppPackage, flat_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Yield a function that starts the C++ observer, with further variables in its environment."""
    started: list[NodeProcess] = []

    def start(variables: dict[str, str] | None = None, **parameters: object) -> NodeProcess:
        given = {"model": flat_path, "current.constant": 0.5, **parameters}
        started.append(package.start(namespace, "observer", given, variables))
        return started[-1]

    yield start
    for node in started:
        node.kill()


def change(vehicle: Vehicle, transition: str) -> bool:
    """Ask the observer for a transition; return whether it succeeded."""
    client = vehicle.node.create_client(ChangeState, "observer/change_state")
    assert client.wait_for_service(PATIENCE_S)
    answer = client.call_async(ChangeState.Request(transition=Transition(label=transition)))
    wait(answer.done, f"an answer to transition {transition}")
    return bool(answer.result().success)


def test_a_lifecycle_manager_drives_it(vehicle: Vehicle, start_cpp: Callable[..., NodeProcess]) -> None:
    start_cpp(autostart=False)
    assert vehicle.sets("name", "front").successful
    for _ in range(2):
        vehicle.hears(UNCONFIGURED, DiagnosticStatus.WARN, len(vehicle.statuses))
        wait(lambda: vehicle.node.count_publishers("observer/estimate") == 0, "no topics")
        assert change(vehicle, "configure")
        vehicle.meets_node()
        told, heard = len(vehicle.statuses), len(vehicle.estimates)
        with vehicle.driving():
            vehicle.hears("inactive: activate the node to publish", DiagnosticStatus.WARN, told)
            wait(lambda since=told: int(newest(vehicle, "forces estimated", since) or 0) > 500, "it is warm")
            assert len(vehicle.estimates) == heard
            began = time.time_ns()
            assert change(vehicle, "activate")
            wait(lambda since=heard: len(vehicle.estimates) > since, "estimates of the active node")
            assert vehicle.stamps()[heard] - began < 10**9
            assert list(vehicle.estimates[heard].name) == ["front"]
            assert change(vehicle, "deactivate")
            time.sleep(0.2)
            heard = len(vehicle.estimates)
            time.sleep(0.2)
            assert len(vehicle.estimates) == heard
        assert change(vehicle, "cleanup")
    assert not change(vehicle, "activate")


def test_a_manager_keeps_a_bond(vehicle: Vehicle, start_cpp: Callable[..., NodeProcess]) -> None:
    start_cpp(autostart=False)
    assert change(vehicle, "configure")
    vehicle.keeps_bond("observer", lambda: change(vehicle, "activate"), lambda: change(vehicle, "deactivate"))


def test_an_input_has_the_quality_that_was_asked_for_and_two_publishers_are_named(
    vehicle: Vehicle, package: CppPackage, flat_path: Path
) -> None:
    lossless = reliable_inputs(vehicle.namespace, ["stamped_current"])  # of a type that is not compiled in
    node = package.start(vehicle.namespace, "observer", {"model": flat_path, **STAMPED_CURRENT, **lossless})
    try:
        vehicle.meets_node()
        (heard,) = vehicle.node.get_subscriptions_info_by_topic(f"{vehicle.namespace}/stamped_current")
        assert heard.qos_profile.reliability == QoSReliabilityPolicy.RELIABLE
        vehicle.node.create_publisher(Temperature, "stamped_current", 1)
        vehicle.hears("stamped_current has 2 publishers, whose samples mix; expected one", None)
    finally:
        node.kill()


@pytest.mark.parametrize("policy", PROMISES)
def test_what_the_middleware_misses_is_silence(
    vehicle: Vehicle, start_cpp: Callable[..., NodeProcess], tmp_path: Path, policy: str
) -> None:
    model = save_flat(plain_damper(max_gap_s=LONG_S), tmp_path / "patient.ces")
    with vehicle.promising(policy, 0.05) as overrides:
        start_cpp(model=model, **overrides)
        vehicle.goes_silent_within(LONG_S)


def newest(vehicle: Vehicle, key: str, since: int) -> str:
    """Return the newest value of a key in the statuses after the first `since`, empty if there is none."""
    return next((v.value for s in reversed(list(vehicle.statuses)[since:]) for v in s.values if v.key == key), "")


def test_if_each_sample_fails_it_starts_anew(
    vehicle: Vehicle, start_cpp: Callable[..., NodeProcess], tmp_path: Path
) -> None:
    fails = tmp_path / "fails"
    node = start_cpp(compile_preload(FAILING_CLOCK, tmp_path, f'-DFAILS="{fails}"'))
    vehicle.meets_node()
    vehicle.drive_until(lambda: len(vehicle.estimates) > 100, "estimates")
    fails.touch()
    with vehicle.driving():
        wait(lambda: vehicle.node.count_publishers("observer/estimate") == 0, "it lets go of its topics")
        fails.unlink()
        vehicle.hears(UNCONFIGURED, DiagnosticStatus.WARN)
        heard = len(vehicle.estimates)
        wait(lambda: len(vehicle.estimates) > heard + 100, "estimates after the restart")
    node.interrupt()
    output = node.ended()[1]
    assert output.count("each sample has failed for 5 s") == output.count("[ERROR]") == 1, output


def test_a_transition_that_fails_says_why(vehicle: Vehicle, start_cpp: Callable[..., NodeProcess]) -> None:
    node = start_cpp(autostart=False, **{"position.type": "no_msgs/msg/Such"})
    assert not change(vehicle, "configure")
    vehicle.hears(UNCONFIGURED, DiagnosticStatus.WARN, len(vehicle.statuses))
    node.interrupt()
    assert node.ended()[1].count("[ERROR]") == 1
