"""`ces iterate` with a rig behind topics: our own live rig follows the set points, is recorded, and is left safe."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

import numpy as np
from conftest import new_namespace
from node_process import NodeProcess
from party import Party
from std_msgs.msg import Float64
from vehicle import RECOVERIES, wait

from ces_observer.errors import RecordingError
from ces_observer.signals import Signals
from ces_rig.errors import RigError
from ces_rig.experiments.commands import INTERVAL_S, RigCommands
from ces_rig.loop.rigs import RosRigSettings
from ces_rig.loop.topic_rig import TopicRig

SAFE_A = 0.35
DEVIATION_M, SILENCE_S = 0.03, 5.0  # a busy computer holds the rig up


class SetPointListener(Party):
    """Hears the set points."""

    def __init__(self, namespace: str) -> None:
        super().__init__("listener", namespace)
        self.currents: list[float] = []
        self.node.create_subscription(Float64, "valve_command", lambda m: self.currents.append(m.data), 1000)


def make_commands() -> RigCommands:
    time_s = np.arange(round(2.0 / INTERVAL_S) + 1) * INTERVAL_S
    fade = np.minimum(1.0, np.minimum(time_s, 2.0 - time_s) / 0.4) ** 3
    return RigCommands("experiment", 0.01 * fade * np.sin(2 * np.pi * 2.0 * time_s), np.where(time_s < 1.0, 0.3, 0.7))


def make_rig(namespace: str, **changes: object) -> TopicRig:
    def topic(name: str) -> dict[str, str]:
        return {"topic": f"{namespace}/{name}"}

    signals = Signals.from_mapping(
        {
            "position": topic("joint_states"),
            "force": topic("measured_force"),
            "current": topic("valve_current") | {"type": "sensor_msgs/msg/JointState", "field": "effort[rear_damper]"},
        },
        "test",
    )
    settings = {
        "stroke_topic": f"{namespace}/stroke_command",
        "current_topic": f"{namespace}/valve_command",
        "safe_current_A": SAFE_A,
        "approach_s": 0.5,
        "deviation_m": DEVIATION_M,
        "silence_s": SILENCE_S,
    }
    return TopicRig(RosRigSettings(**{**settings, **changes}), signals)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def namespace() -> Iterator[str]:
    name = new_namespace()
    rates = {"rate_hz": 200, "command_timeout_s": 2.0}
    parameters = {"drive": "set_points", "stamped_current": True, "noise": 0.1, **rates}
    process = NodeProcess.from_source(name, parameters, "ces_rig.live.node")
    try:
        with SetPointListener(name) as listener:
            wait(lambda: listener.node.count_subscribers(f"{name}/stroke_command") > 0, "the rig starts")
            yield name
    finally:
        process.kill()


def test_the_rig_does_what_was_asked_and_is_left_with_the_safe_current(namespace: str, tmp_path: Path) -> None:
    commands = make_commands()
    stroke_m = pytest.approx(np.ptp(commands.stroke_m), rel=0.15)
    for _ in range(RECOVERIES):  # the stroke is shorter, or none, where a busy computer holds up rig or commands
        with SetPointListener(namespace) as listener, suppress(RecordingError):
            recording = make_rig(namespace).run(commands, tmp_path)
            wait(lambda heard=listener.currents: len(heard) > 5 and heard[-1] == SAFE_A, "the safe current is set")
            position, force = recording.channel("position"), recording.channel("force")
            if np.ptp(position.values) == stroke_m:
                break
    assert len(position) > 200
    assert np.ptp(position.values) == stroke_m
    assert np.ptp(recording.channel("current").values) > 0.3
    at = np.arange(position.stamps_ns[0], position.stamps_ns[-1], 20_000_000)
    stroke, reaction = (np.interp(at, one.stamps_ns, one.values) for one in (position, force))
    assert np.corrcoef(np.gradient(stroke), reaction)[0, 1] > 0.5


def test_a_rig_that_does_not_follow_is_broken_off_and_left_safe(namespace: str, tmp_path: Path) -> None:
    """Set points on a topic that nothing obeys: here the rig's strokes go to another subscriber."""
    with SetPointListener(namespace) as listener:
        listener.node.create_subscription(Float64, "elsewhere", lambda message: None, 10)
        rig = make_rig(namespace, stroke_topic=f"{namespace}/elsewhere", deviation_m=0.004)
        with pytest.raises(RigError, match="mm from its set points"):
            rig.run(make_commands(), tmp_path)
        wait(lambda: len(listener.currents) > 5 and listener.currents[-1] == SAFE_A, "the safe current is set")


def test_ctrl_c_stops_the_program_and_the_same_command_goes_on(namespace: str, tmp_path: Path) -> None:
    (tmp_path / "signals.yaml").write_text(
        f"position: {{topic: {namespace}/joint_states}}\nforce: {{topic: {namespace}/measured_force}}\n"
        f"current: {{topic: {namespace}/valve_current, type: sensor_msgs/msg/JointState, "
        "field: 'effort[rear_damper]'}\n"
    )
    (tmp_path / "plan.yaml").write_text(
        "limits: {stroke_m: 0.015, speed_m_s: 0.4, acceleration_m_s2: 30, low_A: 0.3, high_A: 0.7, frequency_Hz: 8}\n"
        f"rig: {{kind: ros, stroke_topic: {namespace}/stroke_command, current_topic: {namespace}/valve_command,\n"
        f"  signals: signals.yaml, approach_s: 0.5, deviation_m: {DEVIATION_M}, silence_s: {SILENCE_S},\n"
        f"  safe_current_A: {SAFE_A}}}\n"
        "experiments: {duration_s: 8}\nstop: {budget_s: 8}\n"  # so that Ctrl-C on a busy computer is not late
        "identify: {structure: hydraulic, time: 5, threads: 1}\n"
    )
    command = [sys.executable, "-m", "ces_cli.main", "iterate", str(tmp_path / "plan.yaml")]
    with SetPointListener(namespace) as listener:
        first = NodeProcess(command)
        wait((tmp_path / "plan" / "iteration_01" / "commands.csv").exists, "the design")
        wait(lambda: any(current != SAFE_A for current in listener.currents), "the experiment runs")
        first.interrupt(signal.SIGINT)
        status, output = first.ended()
        assert status == 130, output
        wait(lambda: listener.currents[-1] == SAFE_A, "the safe current is set")
    assert not (tmp_path / "plan" / "iteration_01" / "recording").exists()
    status, output = NodeProcess(command).ended()
    assert status == 0, output
    assert "stopped: budget spent: 8.0 of 8 s" in output
