"""The life cycle of observer and controller, driven from outside as lifecycle managers do it."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")
pytest.importorskip("lifecycle_msgs", reason="lifecycle_msgs is not installed")

from launch import LaunchDescription, LaunchService
from launch.actions import EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessStart
from launch.events import matches_action
from launch_ros.actions import LifecycleNode
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState as ChangeStateService
from lifecycle_msgs.srv import GetAvailableStates, GetState
from node_process import NodeProcess, ros_args
from patience import PATIENCE_S
from std_msgs.msg import Float64
from vehicle import Vehicle, wait

from ces_observer.nodes.parameter_table import IN_USE

Start = Callable[..., NodeProcess]
SAFE_A = 0.4
FALLING = """
import sys
from ces_observer.damper_observer import DamperObserver
from ces_observer.limits import NodeLimits
from ces_observer.nodes import managed_node, observer
real, real_fall, calls, falls = DamperObserver.step, managed_node.ManagedNode.fall, [], []
def step(self, *sample):
    calls.append(None)
    if len(calls) > 100 and not falls:  # however few or many samples a busy computer passes on until then
        raise MemoryError("planted")
    return real(self, *sample)
def fall(self, why):
    falls.append(why)
    real_fall(self, why)
DamperObserver.step, managed_node.ManagedNode.fall = step, fall
NodeLimits.FALL_S, NodeLimits.RETRY_S = 0.3, 0.1
sys.exit(observer.main())
"""


class Manager:
    """A lifecycle manager of the node `name` beside the vehicle."""

    def __init__(self, vehicle: Vehicle, name: str) -> None:
        self._change = vehicle.node.create_client(ChangeStateService, f"{name}/change_state")
        self._state = vehicle.node.create_client(GetState, f"{name}/get_state")
        self._states = vehicle.node.create_client(GetAvailableStates, f"{name}/get_available_states")
        assert self._change.wait_for_service(PATIENCE_S)
        assert self._state.wait_for_service(PATIENCE_S)

    def change(self, label: str) -> bool:
        """Ask for a transition; return whether it was done."""
        answer = self._change.call_async(ChangeStateService.Request(transition=Transition(label=label)))
        wait(answer.done, f"an answer to {label}")
        return bool(answer.result().success)

    def state(self) -> str:
        """Return the state of the node."""
        answer = self._state.call_async(GetState.Request())
        wait(answer.done, "an answer about the state")
        return str(answer.result().current_state.label)

    def states(self) -> list[str]:
        """Return all states that the node has."""
        assert self._states.wait_for_service(PATIENCE_S)
        answer = self._states.call_async(GetAvailableStates.Request())
        wait(answer.done, "an answer about the states")
        return [one.label for one in answer.result().available_states]


def test_an_observer_is_driven_by_hand(vehicle: Vehicle, start: Start, tmp_path: Path, model_path: Path) -> None:
    missing = tmp_path / "later.json"
    node = start(model=missing, autostart=False)
    manager = Manager(vehicle, "observer")
    vehicle.hears("unconfigured: configure the node to estimate", None)
    assert {"unconfigured", "inactive", "active", "finalized", "errorprocessing"} < set(manager.states())
    assert not manager.change("activate")
    assert not manager.change("configure")  # there is no such file
    assert manager.state() == "unconfigured"
    missing.write_bytes(model_path.read_bytes())
    words = ["ros2", "lifecycle", "set", f"{vehicle.namespace}/observer", "configure", "--no-daemon"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert "successful" in done.stdout, done.stdout + done.stderr
    with vehicle.driving():
        vehicle.hears("inactive: activate the node to publish", None)
        assert not vehicle.estimates
        assert manager.change("activate")
        wait(lambda: len(vehicle.estimates) > 100, "estimates")
        assert manager.change("deactivate")
        vehicle.hears("inactive: activate the node to publish", None, len(vehicle.statuses))
        count = len(vehicle.estimates)
    assert len(vehicle.estimates) == count
    assert manager.change("cleanup")
    wait(lambda: not vehicle.node.count_publishers("observer/estimate"), "the topic is gone")
    assert vehicle.sets("force.topic", "moved").successful
    assert manager.change("configure")
    assert manager.change("activate")
    vehicle.drive_until(lambda: len(vehicle.estimates) > count + 100, "estimates again")
    assert vehicle.node.count_subscribers("moved") == 1
    assert IN_USE in vehicle.sets("force.topic", "measured_force").reason
    assert manager.change("shutdown")
    assert manager.state() == "finalized"
    node.interrupt()
    status, output = node.ended()
    assert status == 0
    assert output.count("no such model file") == 1, output


@pytest.mark.parametrize("name", ["observer", "controller"])
def test_a_manager_keeps_a_bond(vehicle: Vehicle, namespace: str, model_path: Path, name: str) -> None:
    values = {"model": model_path, "autostart": False}
    node = NodeProcess.from_source(namespace, values, f"ces_observer.nodes.{name}")
    try:
        manager = Manager(vehicle, name)
        assert manager.change("configure")
        vehicle.keeps_bond(name, lambda: manager.change("activate"), lambda: manager.change("deactivate"))
    finally:
        node.kill()


@pytest.fixture
def observer_node(vehicle: Vehicle, model_path: Path) -> Iterator[LifecycleNode]:
    yield LifecycleNode(
        package="ces_observer",
        executable="observer",
        name="observer",
        namespace=vehicle.namespace,
        parameters=[{"model": str(model_path), "autostart": False}],
    )


def test_launch_drives_an_observer(
    vehicle: Vehicle, observer_node: LifecycleNode, laid_out: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Configure it when its process starts, activate it when that is done, and end after its first estimates."""
    for key, value in laid_out.items():
        monkeypatch.setenv(key, value)

    def change(transition: int) -> EmitEvent:
        return EmitEvent(
            event=ChangeState(lifecycle_node_matcher=matches_action(observer_node), transition_id=transition)
        )

    activate = OnStateTransition(
        target_lifecycle_node=observer_node, goal_state="inactive", entities=[change(Transition.TRANSITION_ACTIVATE)]
    )
    configure = OnProcessStart(target_action=observer_node, on_start=[change(Transition.TRANSITION_CONFIGURE)])
    launched = LaunchService()
    launched.include_launch_description(
        LaunchDescription([RegisterEventHandler(configure), RegisterEventHandler(activate), observer_node])
    )

    def end_after_estimates() -> None:
        try:
            wait(lambda: len(vehicle.estimates) > 100, "estimates")
        finally:
            launched.shutdown()

    with vehicle.driving():
        thread = threading.Thread(target=end_after_estimates)
        thread.start()
        assert launched.run() == 0
        thread.join()
    assert len(vehicle.estimates) > 100


def test_a_controller_that_is_deactivated_sends_its_safe_current(
    vehicle: Vehicle, namespace: str, model_path: Path
) -> None:
    commands: list[Float64] = []
    vehicle.node.create_subscription(Float64, "valve_command", commands.append, 100)
    values = {"model": model_path, "autostart": False, "safe_A": SAFE_A}
    node = NodeProcess.from_source(namespace, values, "ces_observer.nodes.controller")
    try:
        manager = Manager(vehicle, "controller")
        assert manager.change("configure")
        assert not commands
        assert manager.change("activate")
        wait(lambda: bool(commands), "a command without estimates")
        assert manager.change("deactivate")
        wait(lambda: commands[-1].data == SAFE_A, "the safe current")
        count = len(commands)
        assert manager.change("cleanup")
        assert len(commands) == count
    finally:
        node.kill()


def test_an_observer_that_only_fails_lets_go_and_comes_back(vehicle: Vehicle, namespace: str, model_path: Path) -> None:
    words = ros_args(namespace, {"model": model_path, "current.constant": 0.5})
    node = NodeProcess([sys.executable, "-c", FALLING, *words])
    try:
        with vehicle.driving(current=None):
            wait(lambda: len(vehicle.estimates) > 500, "estimates after the failure")
        node.interrupt()
        status, output = node.ended()
        assert status == 0
        assert output.count("each sample has failed") == 1, output
    finally:
        node.kill()
