"""What a status says of a damper: level, one line, and values, without ROS."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from math import nan, sin

import pytest
from damper_models import delayed_damper, plain_damper
from hydraulic_models import hydraulic_model
from physical_models import LINEAR

from ces_observer.current_hold import ConstantCurrent
from ces_observer.damper_observer import NO_CURRENT, OFF_CLOCK, POSITION_NOT_FINITE, SILENT, DamperObserver
from ces_observer.health.diagnostics import LEVEL_ERROR, LEVEL_OK, LEVEL_WARN, NodeFacts, Status
from ces_observer.health.health import Health
from ces_observer.health.process import Load
from ces_observer.health.running_cost import RunningCost
from ces_observer.health.streams import Arrivals
from ces_observer.reasons import OK, OUT_OF_ORDER, OUTLIER, UNBOUNDED, WARMING_UP

MS = 1_000_000
SECOND = 1000 * MS


def damper_and_health() -> tuple[DamperObserver, Health]:
    damper = DamperObserver(plain_damper(warm_up_s=0.05), ConstantCurrent(0.5), 0.0)
    return damper, Health(damper, {"model": "model.json"})


def tasks_of(health: Health) -> dict[str, Status]:
    return dict(health.report("", NodeFacts()).tasks)


def told(health: Health, detail: str = "") -> Status:
    """Return level and message of the task `health`, and all values."""
    report = health.report(detail, NodeFacts())
    return replace(dict(report.tasks)["health"], values=report.status.values)


def feed(damper: DamperObserver, first: int, last: int, position: float = 0.01) -> None:
    for k in range(first, last):
        damper.step(k * MS, position, k * MS)


def test_estimating_is_ok() -> None:
    damper, health = damper_and_health()
    feed(damper, 0, 100)
    health.roll(0.1, 0)
    feed(damper, 100, 200)
    health.roll(0.1, 0)
    status = told(health)
    assert (status.level, status.message) == (LEVEL_OK, "estimating")
    values = dict(status.values)
    assert values["rate [Hz]"] == "1000.0"
    assert (values["position samples"], values["reason"], values["model"]) == ("200", OK, "model.json")
    assert int(values["forces estimated"]) + int(values[f"withheld: {WARMING_UP}"]) == 200


def test_delayed_forces_are_counted_if_the_model_has_a_delay() -> None:
    damper = DamperObserver(delayed_damper(0.003), ConstantCurrent(0.5), 0.0)
    health = Health(damper, {})
    feed(damper, 0, 200)
    values = dict(told(health).values)
    assert values["forces estimated"] == values["delayed forces estimated"] == "97"
    assert "delayed forces estimated" not in dict(told(damper_and_health()[1]).values)


def test_what_was_withheld_in_the_window_is_a_warning_and_passes() -> None:
    damper, health = damper_and_health()
    feed(damper, 0, 100)
    health.roll(0.1, 0)
    feed(damper, 90, 100)  # ten repeats
    feed(damper, 100, 190)
    health.roll(0.1, 0)
    assert told(health).level == LEVEL_WARN
    assert told(health).message == "estimating; 10.0% withheld in the last second"
    feed(damper, 190, 290)
    health.roll(0.1, 0)
    assert told(health).level == LEVEL_OK
    assert dict(told(health).values)[f"withheld: {OUT_OF_ORDER}"] == "10"


def test_clamped_inputs_are_a_warning() -> None:
    damper = DamperObserver(plain_damper(warm_up_s=0.05), ConstantCurrent(2.1), 0.0)  # the envelope ends at 2 A
    health = Health(damper, {})
    for begin in (0, 100):
        feed(damper, begin, begin + 100)
        health.roll(0.1, 0)
    status = told(health)
    assert status.level == LEVEL_WARN
    assert "100.0% of the forces from clamped inputs, outside what the model was identified on" in status.message
    assert dict(status.values)["share outside the envelope"] == "1.0000"
    assert dict(status.values)["inputs outside the envelope"] == "are clamped to it"


def test_held_forces_are_a_warning_and_are_counted() -> None:
    damper = DamperObserver(
        replace(plain_damper(warm_up_s=0.05), force_envelope_N=(5.0, 9.0)), ConstantCurrent(0.5), 0.0
    )
    health = Health(damper, {})
    for begin in (0, 100):
        feed(damper, begin, begin + 100)
        health.roll(0.1, 0)
    status = told(health)
    assert (status.level, status.message) == (LEVEL_WARN, "estimating; 100.0% of the forces held at the force envelope")
    assert dict(status.values)["forces held at the force envelope"] == str(damper.tally.held)
    assert damper.tally.held == damper.tally.estimates > 100


def test_extrapolated_inputs_are_a_warning_of_their_own() -> None:
    damper = DamperObserver(hydraulic_model(LINEAR), ConstantCurrent(0.5), 0.0)
    health = Health(damper, {})
    feed(damper, 0, 700, position=0.08)  # the envelope ends at 0.018 m
    health.roll(0.1, 0)
    feed(damper, 700, 800, position=0.08)
    health.roll(0.1, 0)
    status = told(health)
    assert status.level == LEVEL_WARN
    assert "100.0% of the forces extrapolated to inputs outside what the model was identified on" in status.message
    outside = dict(status.values)["inputs outside the envelope"]
    assert outside == "are used as they are up to 2 times the envelope, and clamped beyond"


@pytest.mark.parametrize(
    ("reason", "level"),
    [
        (SILENT, LEVEL_ERROR),
        (NO_CURRENT, LEVEL_ERROR),
        (POSITION_NOT_FINITE, LEVEL_ERROR),
        (OFF_CLOCK, LEVEL_ERROR),
        (UNBOUNDED, LEVEL_ERROR),
        (WARMING_UP, LEVEL_WARN),
        (OUT_OF_ORDER, LEVEL_WARN),
        (OUTLIER, LEVEL_WARN),
    ],
)
def test_reasons_have_their_level_and_are_in_the_line(reason: str, level: int) -> None:
    damper, health = damper_and_health()
    damper.reason = reason
    status = told(health, "since Tuesday")
    assert (status.level, status.message) == (level, f"withholding: {reason}: since Tuesday")
    assert told(health).message == f"withholding: {reason}"


def step(damper: DamperObserver, health: Health, k: int, position: float = 0.01) -> None:
    """Step as the node does: a change of the reason is reported at once."""
    before = damper.reason
    damper.step(k * MS, position, k * MS)
    if damper.reason != before:
        health.note_change(k * MS)


def test_the_shortest_episode_is_in_the_next_status_and_stays_the_last() -> None:
    damper, health = damper_and_health()
    for k in range(200):
        step(damper, health, k)
    told(health)
    for k in range(200, 203):
        step(damper, health, k, nan)
    step(damper, health, 203)
    status = told(health)
    assert status.level == LEVEL_WARN
    assert status.message == f"estimating; recovered from {POSITION_NOT_FINITE} (0.003 s)"
    assert told(health).message == "estimating"
    values = dict(told(health).values)
    assert values["episodes of withholding"] == "2"  # warming up was the first
    assert values["last episode"] == f"0.200 s, for 0.003 s: {POSITION_NOT_FINITE} (3 samples withheld)"


def test_an_episode_with_several_reasons_names_them_in_order() -> None:
    damper, health = damper_and_health()
    for k in range(200):
        step(damper, health, k)
    damper.report_silence()
    health.note_change(300 * MS)
    for k in range(500, 700):
        step(damper, health, k)
    message = told(health).message
    assert f"recovered from {SILENT}, then {WARMING_UP} (0.25 s) and 1 more" in message
    assert dict(told(health).values)["last episode"].endswith("(50 samples withheld)")


def test_an_episode_that_began_before_the_first_clock_does_not_last_since_1970() -> None:
    damper, health = damper_and_health()
    began_ns = 1_795_392_125 * 10**9
    for k in range(200):
        before = damper.reason
        damper.step(began_ns + k * MS, 0.01, began_ns + k * MS)
        if damper.reason != before:
            health.note_change(0 if k < 10 else began_ns + k * MS)  # as the node's clock then says
    assert told(health).message == f"estimating; recovered from {WARMING_UP} (0 s)"
    assert dict(told(health).values)["last episode"].startswith("1795392125.0")


def test_an_ended_episode_is_reported_even_if_another_has_begun() -> None:
    damper, health = damper_and_health()
    for k in range(200):
        step(damper, health, k, nan if k == 100 else 0.01)
    step(damper, health, 200, 0.09)
    message = told(health).message
    assert message == f"withholding: {OUTLIER}; recovered from {POSITION_NOT_FINITE} (0.001 s) and 1 more"


def test_every_one_of_many_episodes_is_counted() -> None:
    damper, health = damper_and_health()
    chance = random.Random(1)
    episodes, withheld, bad = 0, 0, False
    for k in range(100):
        step(damper, health, k)
    for k in range(100, 2100):
        before, bad = bad, k < 2099 and chance.random() < 0.4
        step(damper, health, k, nan if bad else 0.01)
        episodes += bad and not before
        withheld += bad
        if k % 100 == 0:
            health.roll(0.1, k * MS)
            told(health)
    assert health.episodes.total == episodes + 1  # warming up was the first
    assert dict(told(health).values)[f"withheld: {POSITION_NOT_FINITE}"] == str(withheld)


def test_the_status_shows_inputs_latency_and_load() -> None:
    damper, health = damper_and_health()
    for k in range(100, 1100):
        if k % 100:
            health.position.take(k * MS, k * MS + MS // 2)
        health.latency.take(200_000 if k % 20 else 5 * MS)
    health.roll(1.0, 0, Load(process=0.153, executor=0.1))
    values = dict(told(health).values)
    assert values["position: rate [Hz]"] == "990.0"
    assert values["position: age, mean [ms]"] == "0.500"
    assert values["position: dropped"] == "9"
    assert float(values["latency from stamp to publish, p50 [ms]"]) == pytest.approx(0.2, rel=0.01)
    assert float(values["latency from stamp to publish, p99 [ms]"]) == pytest.approx(5.0, rel=0.01)
    assert values["latency from stamp to publish, max [ms]"] == "5.000"
    assert (values["process load [% of a core]"], values["executor load [% of a core]"]) == ("15.3", "10.0")
    assert not any(key.startswith(("current:", "measured force")) for key in values)
    damper.reason = OK
    assert tasks_of(health)["frequency"].message == "position 990.0 Hz"  # 0.9 % lost is not worth a warning


def test_lost_positions_are_a_warning() -> None:
    damper, health = damper_and_health()
    for k in range(100, 1100):
        if k % 10:
            health.position.take(k * MS, k * MS)
    health.roll(1.0, 0)
    damper.reason = OK
    status = tasks_of(health)["frequency"]
    words = "9.9% of the positions missing: lost on the way, or the source paused"
    assert (status.level, status.message) == (LEVEL_WARN, f"position 900.0 Hz; {words}")
    assert health.report("", NodeFacts()).status.message == f"estimating; {words}"


def compare(cost: RunningCost, first_s: int, last_s: int, factor: float, each_second: Callable[[int], None]) -> None:
    """Measure at 1 kHz a force that is `factor` times the estimate."""
    for k in range(first_s * 1000, last_s * 1000):
        force = 1000.0 * sin(k * 0.012)
        cost.add_estimate(k * MS, force)
        cost.add_measured(k * MS, factor * force)
        if k % 1000 == 999:
            each_second(k * MS)


class Notes:
    """Keeps the drifts of which it was told."""

    def __init__(self) -> None:
        self.state, self.drifts = "taken", list[str]()

    def note_drift(self, drift: str) -> bool:
        self.drifts.append(drift)
        return True


def test_a_drift_asks_for_one_snapshot_and_is_named_until_it_is_over() -> None:
    cost, damper, notes = RunningCost(window_s=5, warn_J=20.0), damper_and_health()[0], Notes()
    health = Health(damper, {"model": "model.json"}, cost=cost, snapshots=notes, name="rear_damper")
    damper.reason = OK
    messages: list[str] = []

    def each_second(now_ns: int) -> None:
        health.roll(1.0, now_ns)
        messages.append(tasks_of(health)["model"].message)

    compare(cost, 0, 10, 1.05, each_second)
    assert set(messages) == {damper.model.size}
    assert dict(told(health).values)["running cost J [%]"] == "4.76"
    compare(cost, 10, 20, 1.6, each_second)
    status = tasks_of(health)["model"]
    assert status.level == LEVEL_WARN
    assert status.message.startswith(
        f"{damper.model.size}; re-identify: the cost J against the measured force is 37.5%"
    )
    assert status.message.endswith("expected below 20.0%; snapshot taken")
    assert len(notes.drifts) == 1 and notes.drifts[0].startswith("rear_damper: the cost J")
    compare(cost, 20, 32, 1.05, each_second)
    assert messages[-1] == damper.model.size
    assert dict(told(health).values)["threshold of J [%]"] == "20.00"


def test_without_a_recent_measured_force_there_is_no_cost() -> None:
    cost, damper = RunningCost(window_s=5), damper_and_health()[0]
    health = Health(damper, {}, cost=cost)
    compare(cost, 0, 3, 1.05, lambda now_ns: health.roll(1.0, now_ns))
    assert dict(told(health).values)["running cost J [%]"] == "4.76"
    health.roll(1.0, 4 * SECOND)
    assert dict(told(health).values)["running cost J [%]"] == "none"


def test_after_a_reload_the_status_shows_the_new_models_facts_and_cost() -> None:
    damper, health = damper_and_health()
    cost = RunningCost(warn_J=33.0)
    health.set_damper(damper, {"model": "other.json"}, cost)
    values = dict(told(health).values)
    assert (values["model"], values["threshold of J [%]"]) == ("other.json", "33.00")


@pytest.mark.parametrize(("stamped", "apart_ms", "is_told"), [(False, 30, True), (True, 30, False), (True, 300, True)])
def test_stamps_of_position_and_current_by_two_clocks_are_a_warning(
    stamped: bool, apart_ms: int, is_told: bool
) -> None:
    health = damper_and_health()[1]
    health.current = Arrivals(stamped)
    for k in range(1, 1001):
        health.position.take(k * MS, (k + apart_ms) * MS)
        health.current.take((k + apart_ms) * MS, (k + apart_ms) * MS)
    health.roll(1.0, 0)
    words = f"; the current is stamped +{apart_ms / 1e3:.3f} s off them: by another clock? current.delay takes that off"
    assert tasks_of(health)["time stamps"].message == (
        f"positions arrive {apart_ms}.0 ms after their stamp" + (words if is_told else "")
    )
