"""What a status says of a damper: level, one line, and values, without ROS."""

from __future__ import annotations

import pytest
from damper_models import plain_damper

from ces_observer.current_hold import ConstantCurrent
from ces_observer.damper_observer import NO_CURRENT, OFF_CLOCK, POSITION_NOT_FINITE, SILENT, DamperObserver
from ces_observer.estimator import UNBOUNDED, WARMING_UP
from ces_observer.health import LEVEL_ERROR, LEVEL_OK, LEVEL_WARN, Health
from ces_observer.tracker import OK, OUT_OF_ORDER, OUTLIER

MS = 1_000_000


def damper_and_health() -> tuple[DamperObserver, Health]:
    damper = DamperObserver(plain_damper(warm_up_s=0.05), ConstantCurrent(0.5), 0.0)
    return damper, Health(damper, {"model": "model.json"})


def feed(damper: DamperObserver, first: int, last: int, position: float = 0.01) -> None:
    for k in range(first, last):
        damper.step(k * MS, position, k * MS)


def test_estimating_is_ok() -> None:
    damper, health = damper_and_health()
    feed(damper, 0, 100)
    health.roll(0.1)
    feed(damper, 100, 200)
    health.roll(0.1)
    status = health.status("")
    assert (status.level, status.message) == (LEVEL_OK, "estimating")
    values = dict(status.values)
    assert values["rate [Hz]"] == "1000.0"
    assert (values["position samples"], values["reason"], values["model"]) == ("200", OK, "model.json")
    assert int(values["forces estimated"]) + int(values[f"withheld: {WARMING_UP}"]) == 200


def test_what_was_withheld_in_the_window_is_a_warning_and_passes() -> None:
    damper, health = damper_and_health()
    feed(damper, 0, 100)
    health.roll(0.1)
    feed(damper, 90, 100)  # ten repeats
    feed(damper, 100, 190)
    health.roll(0.1)
    assert health.status("").level == LEVEL_WARN
    assert health.status("").message == "estimating; 10.0% withheld in the last second"
    feed(damper, 190, 290)
    health.roll(0.1)
    assert health.status("").level == LEVEL_OK
    assert dict(health.status("").values)[f"withheld: {OUT_OF_ORDER}"] == "10"


def test_extrapolation_is_a_warning() -> None:
    damper, health = damper_and_health()
    feed(damper, 0, 100, position=0.2)  # the envelope ends at 0.1 m
    health.roll(0.1)
    feed(damper, 100, 200, position=0.2)
    health.roll(0.1)
    status = health.status("")
    assert status.level == LEVEL_WARN
    assert "100.0% of the forces from inputs outside" in status.message
    assert dict(status.values)["extrapolated share"] == "1.0000"


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
    status = health.status("since Tuesday")
    assert (status.level, status.message) == (level, f"withholding: {reason}: since Tuesday")
    assert health.status("").message == f"withholding: {reason}"


def test_an_empty_window_has_no_rate() -> None:
    _, health = damper_and_health()
    health.roll(1.0)
    assert dict(health.status("").values)["rate [Hz]"] == "0.0"
