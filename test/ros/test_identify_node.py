"""The node `identify` on a real ROS 2: progress, costs, a model that an observer takes over, Ctrl-C, mistakes."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from node_process import ROOT, NodeProcess, ros_args
from party import Party
from vehicle import Vehicle, wait

from ces_observer.model import load_model
from ces_observer.nodes.outputs import LATCHED

QUICK = {"terms": 2, "threads": 1, "part": "[0.0, 8.0]", "bags": f"[{ROOT / 'bags' / 'noise' / 'noise.mcap'}]"}
Begin = Callable[..., NodeProcess]


class Listener(Party):
    """Hears what the node in a namespace publishes."""

    def __init__(self, namespace: str) -> None:
        super().__init__("listener", namespace)
        self.progress: list[DiagnosticStatus] = []
        self.results: list[DiagnosticArray] = []
        hear = self.node.create_subscription
        hear(DiagnosticArray, "identify/progress", lambda message: self.progress.extend(message.status), 10)
        hear(DiagnosticArray, "identify/result", self.results.append, LATCHED)

    def hears(self, line: str) -> None:
        """Wait for progress whose line holds `line`."""
        wait(lambda: any(line in status.message for status in list(self.progress)), line)


@pytest.fixture
def listener(namespace: str) -> Iterator[Listener]:
    with Listener(namespace) as listener:
        yield listener


@pytest.fixture
def begin(namespace: str, tmp_path: Path) -> Iterator[Begin]:
    begun: list[NodeProcess] = []

    def begin_node(**parameters: object) -> NodeProcess:
        given = {**QUICK, "out": tmp_path / "model.json", **parameters}
        begun.append(NodeProcess.from_source(namespace, given, "ces_cli.identify.node"))
        return begun[-1]

    yield begin_node
    for node in begun:
        node.kill()


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def test_a_model_is_identified_told_and_taken_over_by_a_running_observer(
    listener: Listener, begin: Begin, vehicle: Vehicle, start: Begin, namespace: str, tmp_path: Path
) -> None:
    start()
    vehicle.meets_node()
    node = begin(time=60.0, starts=1, report=tmp_path / "report.html", termz=3)
    wait(lambda: bool(listener.results), "the costs")
    wait(lambda: any(status.message == "done" for status in list(listener.progress)), "done")  # not "starts done"
    stages = dict.fromkeys(values(status)["stage"] for status in listener.progress)
    assert [stage for stage in stages if stage != "starting"] == ["reading", "searching", "writing", "done"]
    assert 0.0 < float(values(listener.progress[-1])["J [%]"]) < 100.0
    about, *costs = listener.results[0].status
    sha256 = load_model(tmp_path / "model.json").digest()
    assert values(about)["model sha256"] == sha256
    assert vehicle.sets("model", values(about)["model"]).successful

    def taken_over() -> bool:
        vehicle.drive(0.2)
        return any(values(status).get("model sha256") == sha256 for status in vehicle.statuses)

    wait(taken_over, "the observer runs the new model")
    assert [status.name for status in costs] == [f"{namespace}/identify: noise"] * 2
    assert [values(status)["role"] for status in costs] == ["identification", "validation"]
    assert (tmp_path / "report.html").exists()
    assert node.is_running()
    node.interrupt()
    status, output = node.ended()
    assert status == 0, output
    assert "Traceback" not in output
    assert "parameter 'termz' is unknown and ignored" in output
    assert "current: std_msgs/msg/Float64 on /valve_current has no header" in output


def test_ctrl_c_ends_the_search_with_the_best_model_so_far(listener: Listener, begin: Begin, tmp_path: Path) -> None:
    node = begin(time=600.0, starts=300, terms=10)
    listener.hears("selection cost J")
    node.interrupt()
    status, output = node.ended()
    assert status == 0, output
    assert "Traceback" not in output
    wait(lambda: bool(listener.results), "the costs")
    sha256 = load_model(tmp_path / "model.json").digest()
    assert values(listener.results[0].status[0])["model sha256"] == sha256


def test_sigterm_before_there_is_a_model_leaves_none(listener: Listener, begin: Begin, tmp_path: Path) -> None:
    node = begin(time=600.0)
    listener.hears("reading")
    node.interrupt(signal.SIGTERM)
    status, output = node.ended()
    assert status == 0, output
    assert "stopped without a model; nothing was written" in output
    assert not (tmp_path / "model.json").exists()


def test_a_mistake_that_its_process_finds_ends_it_with_one_line(begin: Begin) -> None:
    status, output = begin(bags="[/nowhere]").ended()
    assert status == 2
    reason = "/nowhere: no such file or folder"
    assert len([line for line in output.splitlines() if "[FATAL]" in line and reason in line]) == 1, output
    assert "Traceback" not in output


@pytest.mark.parametrize(
    ("parameter", "reason"),
    [
        ({"bags": "['']"}, "parameter 'bags' is not set"),
        ({"terms": 999}, "parameter 'terms' is 999; expected a whole number from 0 to 200"),
    ],
)
def test_a_wrong_parameter_is_one_fatal_line_and_status_2(
    capfd: pytest.CaptureFixture[str], parameter: dict[str, object], reason: str
) -> None:
    """In this process, which is quicker."""
    from ces_cli.identify.node import main

    assert main(ros_args("/mistake", {**QUICK, **parameter})) == 2
    output = capfd.readouterr().err
    assert output.count("[FATAL]") == 1 and reason in output, output
