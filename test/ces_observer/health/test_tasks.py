"""What the tasks of diagnostics say beside the task `health`."""

from __future__ import annotations

from damper_models import plain_damper

from ces_observer.current_hold import ConstantCurrent, CurrentHold
from ces_observer.damper_observer import DamperObserver
from ces_observer.health.diagnostics import (
    INACTIVE,
    LEVEL_ERROR,
    LEVEL_OK,
    LEVEL_WARN,
    NodeFacts,
    Status,
    unconfigured_report,
)
from ces_observer.health.health import Health
from ces_observer.health.running_cost import RunningCost
from ces_observer.reasons import OK

MS = 1_000_000


def make_health() -> tuple[DamperObserver, Health]:
    damper = DamperObserver(plain_damper(warm_up_s=0.05), ConstantCurrent(0.5), 0.0)
    return damper, Health(damper, {"model": "model.json"})


def tasks_of(health: Health, node: NodeFacts | None = None) -> dict[str, Status]:
    return dict(health.report("", node or NodeFacts()).tasks)


def test_the_keys_of_the_tasks_are_at_most_twenty_and_are_among_all_values() -> None:
    damper, health = make_health()
    health.cost = RunningCost()
    damper.current = CurrentHold(1.0)
    for k in range(100):
        damper.step(k * MS, 0.01, k * MS)
        health.current.take(k * MS, k * MS)
        health.position.take(k * MS, k * MS)
    health.roll(0.1, 0)
    assert tasks_of(health)["frequency"].message == "position 1000.0 Hz, current 1000.0 Hz"
    named = ("last change of the model", "unexpected errors", "model sha256", "computed by")
    node = NodeFacts(values=tuple((name, "none") for name in named))
    report = health.report("", node)
    shown = [pair for _, status in report.tasks for pair in status.values]
    assert [name for name, _ in report.tasks] == ["health", "frequency", "time stamps", "model"]
    assert len(shown) == 20 and set(shown) <= set(report.status.values)
    assert report.status.level == max(status.level for _, status in report.tasks)


def test_no_position_is_an_error_once_a_second_is_over() -> None:
    _, health = make_health()
    assert tasks_of(health)["frequency"].message == "not measured yet"
    health.roll(1.0, 0)
    assert (tasks_of(health)["frequency"].level, tasks_of(health)["frequency"].message) == (LEVEL_ERROR, "no position")


def test_a_publisher_that_cannot_be_heard_is_a_warning() -> None:
    _, health = make_health()
    health.position.take(0, 0)
    health.roll(1.0, 0)
    health.mismatch = "/joint_states carries std_msgs/msg/Float64, too"
    status = tasks_of(health)["frequency"]
    assert (status.level, status.message) == (LEVEL_WARN, f"position 1.0 Hz; {health.mismatch}")


def test_what_was_wrong_with_the_stamps_of_a_second_is_a_warning_and_passes() -> None:
    _, health = make_health()
    for k in [*range(1000), 999, 998]:
        health.position.take(k * MS, k * MS + MS // 2)
    health.position.take(10**18, 1000 * MS)
    health.note_jump("the wall clock was set by +2.000 s")
    health.roll(1.0, 0)
    status = tasks_of(health)["time stamps"]
    assert status.level == LEVEL_WARN and status.message.startswith("positions arrive ")
    assert status.message.endswith(
        "2 positions repeat or run backwards; 1 interruptions of the stamps; the wall clock was set by +2.000 s"
    )
    for k in range(1000, 2000):
        health.position.take(k * MS, k * MS + MS // 2)
    health.roll(1.0, 0)
    status = tasks_of(health)["time stamps"]
    assert (status.level, status.message) == (LEVEL_OK, "positions arrive 0.5 ms after their stamp")
    assert dict(status.values)["jumps of time"] == "1, the last: the wall clock was set by +2.000 s"


def test_a_refused_model_is_a_warning_of_the_task_model() -> None:
    damper, health = make_health()
    status = tasks_of(health, node=NodeFacts(values=(("last change of the model", "refused, it is none"),)))["model"]
    assert (status.level, status.message) == (
        LEVEL_WARN,
        f"{damper.model.size}; the last change was refused, it is none",
    )


def test_a_node_that_is_not_active_says_what_to_do() -> None:
    damper, health = make_health()
    damper.reason = OK
    inactive = health.report("", NodeFacts(INACTIVE, ("2 unexpected errors",)))
    status = dict(inactive.tasks)["health"]
    assert (status.level, status.message) == (LEVEL_WARN, "inactive: activate the node to publish")
    assert (inactive.reason, dict(status.values)["reason"]) == (INACTIVE, OK)
    ((_, status),) = unconfigured_report("estimate").tasks
    assert (status.level, status.message) == (LEVEL_WARN, "unconfigured: configure the node to estimate")
