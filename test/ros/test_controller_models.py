"""Another model for a running controller: by parameter and service; without a bump, never a bad one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from conftest import new_namespace
from damper_models import damper_with_past, delayed_damper
from diagnostic_msgs.msg import DiagnosticArray
from node_process import NodeProcess
from party import Party
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from vehicle import ModelReloads, lossless_topics, wait

DEEP = QoSProfile(depth=50_000)
STEP_NS = 5_000_000  # between the stamps of estimates, whatever the time between their publishing
RECOVERY_S = 0.2
TUNING = {"low_A": 0.0, "high_A": 2.0, "safe_A": 0.0, "recovery_s": RECOVERY_S, "feedback": "none", "timeout_s": 10.0}
CURVE = {"curve.speeds_m_s": [-2.0, 0.0, 2.0], "curve.forces_N": [-5600.0, 0.0, 5600.0]}


def current_A(past: float) -> float:
    """Return the current at which 2800 N are the steady force at 1 m/s: (200 + 100 current) / (1 - past)."""
    return (2800.0 * (1.0 - past) - 200.0) / 100.0


class Loop(Party):
    """The rest of the loop: estimates 1 m/s without end, hears commands and diagnostics, and has the model changed."""

    def __init__(self, namespace: str) -> None:
        super().__init__("loop", namespace)
        self._stamp_ns = 10**18
        self.commands: list[float] = []
        self.told: list[dict[str, str]] = []
        self._estimates = self.node.create_publisher(JointState, "observer/estimate", DEEP)
        self.reloads = ModelReloads(self.node, "controller")
        self.node.create_subscription(Float64, "valve_command", lambda m: self.commands.append(m.data), DEEP)
        self.node.create_subscription(DiagnosticArray, "controller/details", self._hear, DEEP)

    @contextmanager
    def estimating(self) -> Iterator[None]:
        """Publish estimates beside what is done in this context."""
        wait(lambda: self._estimates.get_subscription_count() > 0, "the controller subscribes to estimates")
        with self.repeating(STEP_NS * 1e-9, self._estimate):
            yield

    def set_model(self, path: Path) -> str:
        """Set the parameter; return why it is refused, or what happens."""
        return str(self.set_parameters("controller", {"model": str(path)}).reason)

    def get_model(self) -> object:
        return self.get_parameter("controller", "model")

    def commands_for(self, past: float) -> None:
        """Wait for the current of such a damper."""
        wanted = pytest.approx(current_A(past), abs=1e-3)
        wait(lambda: bool(self.commands) and self.commands[-1] == wanted, f"{current_A(past):g} A")

    def hears(self, key: str, text: str) -> None:
        """Wait for diagnostics whose value at `key` has `text` in it."""
        wait(lambda: any(text in told.get(key, "") for told in list(self.told)), f"'{text}' in '{key}'")

    def _estimate(self) -> None:
        self._stamp_ns += STEP_NS
        message = JointState(name=["rear_damper"], position=[0.0], velocity=[1.0], effort=[2800.0])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self._stamp_ns, 10**9)
        self._estimates.publish(message)

    def _hear(self, message: DiagnosticArray) -> None:
        self.told.extend({v.key: v.value for v in s.values} for s in message.status)


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Loop]:
    """Yield a loop that runs through all tests of this module, and see at their end that its current never jumped."""
    with Loop(new_namespace()) as loop:
        path = tmp_path_factory.mktemp("controlled") / "first.json"
        damper_with_past(0.9).save(path)
        lossless = lossless_topics(loop.namespace, ["observer/estimate"], ["valve_command"])
        given = {"model": path, "max_age_s": 0.0, **TUNING, **CURVE, **lossless}
        node = NodeProcess.from_source(loop.namespace, given, "ces_observer.nodes.controller")
        try:
            with loop.estimating():
                loop.commands_for(0.9)
                yield loop
        finally:
            node.kill()
    largest = 2.0 * STEP_NS * 1e-9 / RECOVERY_S  # of the way between any two currents within the limits
    assert max(abs(b - a) for a, b in pairwise(loop.commands)) <= largest
    assert not [key for key in loop.told[-1] if key.startswith("interruptions") and "no estimates" not in key]


def test_by_parameter_and_by_service_which_reads_the_file_again(loop: Loop, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    damper_with_past(0.91).save(path)
    assert f"{path}: is being checked; the outcome comes on " in loop.set_model(path)
    loop.commands_for(0.91)
    loop.hears("last change of the model", f"{path}: has taken over")
    damper_with_past(0.9).save(path)
    answer = loop.reloads.call()
    assert answer.success, answer.message
    assert f"takes over within {RECOVERY_S:g} s" in answer.message
    loop.commands_for(0.9)
    loop.hears("model sha256", damper_with_past(0.9).digest())


def test_what_cannot_be_used_is_refused_with_the_reason(loop: Loop, tmp_path: Path) -> None:
    before, command = loop.get_model(), loop.commands[-1]
    assert "none.json: no such model file" in loop.set_model(tmp_path / "none.json")
    one_way, unstable, late = (tmp_path / f"{name}.json" for name in ("one_way", "unstable", "late"))
    replace(damper_with_past(0.8), envelope=replace(damper_with_past(0.8).envelope, speed_m_s=(0.0, 2.0))).save(one_way)
    damper_with_past(1.01).save(unstable)
    delayed_damper(0.003).save(late)
    for path, reason in (
        (one_way, "a controller needs both directions"),
        (unstable, "not proved to be a contraction"),
        (late, "forces come 0.003 s late; a controller needs a model with --delay 0"),
    ):
        assert "the outcome comes on " in loop.set_model(path)  # for all that can be seen at once
        loop.hears("last change of the model", reason)
        wait(lambda: loop.get_model() == before, "the parameter goes back")
    assert loop.commands[-1] == pytest.approx(command, abs=1e-3)
