"""The controller node on a real ROS 2: the pure controller's commands, the safe current whenever it is called for."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from math import cos, nan
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from conftest import new_namespace
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from node_process import NodeProcess
from party import Party
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from vehicle import lossless_topics, stamp_of, wait

from ces_observer.control.force_controller import ForceController, ForceCurve, Tuning
from ces_observer.control.inverse_map import compute_inverse_map, current_lag_s
from ces_observer.model import load_model
from ces_observer.nodes.parameter_table import FORCES, SPEEDS

CONTROLLER = "ces_observer.nodes.controller"
MS = 1_000_000
DEEP = QoSProfile(depth=5000)
LIMITS = {"low_A": 0.1, "high_A": 1.9, "safe_A": 0.3}
CURVE = {SPEEDS: [-2.0, 0.0, 2.0], FORCES: [-5600.0, 0.0, 5600.0]}  # 0.8 A of the plain damper


class Surroundings(Party):
    """What stands around the controller: an observer and a load cell that say what they are told, ears for the rest."""

    def __init__(self, namespace: str) -> None:
        super().__init__("surroundings", namespace)
        self.commands: list[float] = []
        self.desired: list[WrenchStamped] = []
        self.statuses: list[DiagnosticStatus] = []
        self._estimates = self.node.create_publisher(JointState, "observer/estimate", DEEP)
        self._forces = self.node.create_publisher(WrenchStamped, "measured_force", DEEP)
        self.node.create_subscription(Float64, "valve_command", self._hear_command, DEEP)
        self.node.create_subscription(WrenchStamped, "controller/desired_force", self.desired.append, DEEP)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear_diagnostics, DEEP)

    def meets_node(self) -> None:
        wait(lambda: self._estimates.get_subscription_count() > 0, "the node subscribes to estimates")
        wait(lambda: len(self.commands) > 0, "the node commands the safe current")

    def estimate(self, stamp_ns: int, speed_m_s: float, force_N: float) -> None:
        message = JointState(name=["rear_damper"], position=[0.0], velocity=[speed_m_s], effort=[force_N])
        message.header.frame_id = "chassis"
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        self._estimates.publish(message)

    def measure(self, force_N: float) -> None:
        message = WrenchStamped()
        message.wrench.force.z = force_N
        self._forces.publish(message)

    def driving(self, speed_m_s: float = 1.0, age_s: float = 0.0) -> AbstractContextManager[None]:
        """Estimate 2800 N at 200 Hz, now or as if this long ago, beside what is done in this context."""
        age_ns = round(age_s * 1e9)
        return self.repeating(0.005, lambda: self.estimate(time.time_ns() - age_ns, speed_m_s, 2800.0))

    def reaches(self, current_A: float, within_A: float = 1e-9) -> None:
        """Wait for this command."""
        wait(lambda: abs(self.commands[-1] - current_A) <= within_A, f"a command of {current_A} A")

    def set(self, **values: object) -> str:
        """Set parameters of the controller together; return why they are refused, empty if they are not."""
        asked = {name.replace("__", "."): value for name, value in values.items()}
        return str(self.set_parameters("controller", asked).reason)

    def hears(self, text: str, level: bytes) -> DiagnosticStatus:
        def found() -> DiagnosticStatus | None:
            return next((s for s in list(self.statuses) if text in s.message and s.level == level), None)

        wait(lambda: found() is not None, f"'{text}' in {[s.message for s in self.statuses]}")
        status = found()
        assert status is not None
        return status

    def _hear_command(self, message: Float64) -> None:
        self.commands.append(message.data)

    def _hear_diagnostics(self, message: DiagnosticArray) -> None:
        self.statuses.extend(s for s in message.status if s.name.startswith(f"{self.namespace}/controller: "))


@pytest.fixture
def surroundings(namespace: str) -> Iterator[Surroundings]:
    with Surroundings(namespace) as made:
        yield made


@pytest.fixture
def start(surroundings: Surroundings, model_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    started: list[NodeProcess] = []

    def begin(**parameters: object) -> NodeProcess:
        given = {"model": model_path, **LIMITS, **CURVE, **parameters}
        started.append(NodeProcess.from_source(surroundings.namespace, given, CONTROLLER))
        surroundings.meets_node()
        return started[-1]

    yield begin
    for node in started:
        node.kill()


def test_commands_are_the_pure_controllers(
    surroundings: Surroundings, start: Callable[..., NodeProcess], namespace: str, model_path: Path
) -> None:
    """Every estimate is answered, in order, by what the controller gives offline; speeds and forces are arbitrary."""
    start(max_age_s=0.0, timeout_s=10.0, **lossless_topics(namespace, ["observer/estimate"], ["valve_command"]))
    model = load_model(model_path)
    tuning = Tuning(**LIMITS, valve_lag_s=0.0, timeout_s=10.0)
    tuning = replace(tuning, valve_lag_s=Tuning.lead_s(current_lag_s(model), tuning.preview_s))
    pure = ForceController(ForceCurve.from_points(*CURVE.values()), compute_inverse_map(model), tuning)
    samples = [(10**18 + k * MS, 1.2 * cos(0.02 * k), 2600.0 * cos(0.02 * k + 0.1)) for k in range(1000)]
    expected = [pure.step(*sample) for sample in samples]
    for sample in samples:
        surroundings.estimate(*sample)
    wait(lambda: len(surroundings.desired) == len(samples), "an answer to every estimate")
    wait(lambda: expected[-1] in surroundings.commands, "the last command")
    first = surroundings.commands.index(expected[1])
    followed = surroundings.commands[first : first + len(expected) - 1]
    assert followed == pytest.approx(expected[1:], abs=1e-12)
    assert max(expected) - min(expected) > 1.0
    assert [stamp_of(message) for message in surroundings.desired] == [stamp for stamp, _, _ in samples]
    assert surroundings.desired[0].wrench.force.z == pytest.approx(3360.0)
    assert surroundings.desired[0].header.frame_id == "chassis"


def test_the_safe_current_holds_whenever_there_is_no_usable_estimate(
    surroundings: Surroundings, start: Callable[..., NodeProcess]
) -> None:
    node = start()
    assert set(surroundings.commands) == {0.3}
    surroundings.hears("observer/estimate has a publisher that is silent", DiagnosticStatus.ERROR)
    with surroundings.driving():
        surroundings.reaches(0.8, within_A=0.05)
    surroundings.reaches(0.3)
    for fault, told in (({"speed_m_s": nan}, "the estimate is not finite"), ({"age_s": 3.0}, "the estimate is stale")):
        with surroundings.driving():
            surroundings.reaches(0.8, within_A=0.05)
        with surroundings.driving(**fault):
            surroundings.hears(told, DiagnosticStatus.ERROR)
            surroundings.reaches(0.3)
    node.interrupt(signal.SIGINT)
    status, output = node.ended()
    assert (status, "Traceback" in output) == (0, False), output


def test_parameters_change_live_or_are_refused(surroundings: Surroundings, start: Callable[..., NodeProcess]) -> None:
    start()
    assert "high_A 0.05; expected the lower limit first" in surroundings.set(high_A=0.05)
    assert "would drive the motion" in surroundings.set(curve__forces_N=[5.0, 0.0, 5.0])
    assert "expected one of estimate, measured, none" in surroundings.set(feedback="some")
    assert surroundings.set(curve__forces_N=[-4800.0, 0.0, 4800.0], feedback="none") == ""
    with surroundings.driving():
        surroundings.reaches(0.4, within_A=0.01)  # 2400 N at 1 m/s
        assert surroundings.set(low_A=0.25, high_A=0.35) == ""
        surroundings.reaches(0.35)


def test_the_measured_force_is_fed_back_and_missed(
    surroundings: Surroundings, start: Callable[..., NodeProcess]
) -> None:
    start(feedback="measured")
    with surroundings.driving():
        with surroundings.repeating(0.005, lambda: surroundings.measure(2500.0)):
            wait(lambda: surroundings.commands[-1] > 0.85, "a trim")
        surroundings.hears("no measured force is fed back: feed-forward alone", DiagnosticStatus.WARN)


@pytest.mark.parametrize(
    ("parameters", "told"),
    [
        ({"model": "/nowhere.json"}, "/nowhere.json: no such model file"),
        ({"safe_A": 1.0}, "safe_A is 1; expected it within 0.29 to 0.7 A"),
    ],
)
def test_a_mistake_ends_in_one_line(model_path: Path, parameters: dict[str, object], told: str) -> None:
    status, output = NodeProcess.from_source(new_namespace(), {"model": model_path, **parameters}, CONTROLLER).ended()
    fatal = [line for line in output.splitlines() if "[FATAL]" in line]
    assert (status, len(fatal), "Traceback" in output) == (2, 1, False), output
    assert told in fatal[0]
