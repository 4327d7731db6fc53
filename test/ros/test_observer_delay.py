"""Delays: a signal's moves the stamps of its samples back; a model's estimates come later, on topics of their own."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import replace
from math import nan
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from bands import BAND
from damper_models import damper_with_past, delayed_damper, plain_damper
from node_process import NodeProcess
from patience import wait_until
from replay import Offline, currents, jittered_positions, numbers_of
from sensor_msgs.msg import JointState
from vehicle import DEEP, JOINT, STAMPED_CURRENT, Vehicle, lossless_topics, stamp_of, wait

from ces_observer.model import Model

Start = Callable[..., NodeProcess]
DELAY_NS = 100_000_000
DELAYED, DELAYED_BAND = TOPICS = ("observer/estimate_delayed", "observer/estimate_delayed_band")
NO_GAP = {"max_gap_s": 5.0}  # with samples that a busy computer holds up


def hear(vehicle: Vehicle, topic: str) -> list[JointState]:
    """Return a list that the messages on a topic are kept in from now on."""
    heard: list[JointState] = []
    vehicle.node.create_subscription(JointState, topic, heard.append, DEEP)
    return heard


def saved(model: Model, folder: Path, name: str = "model") -> Path:
    model.save(folder / f"{name}.json")
    return folder / f"{name}.json"


def test_estimates_have_the_stamps_of_when_positions_were_measured(vehicle: Vehicle, start: Start) -> None:
    start(**{"position.delay": DELAY_NS * 1e-9})
    vehicle.meets_node()
    vehicle.drive_until(lambda: len(vehicle.estimates) > 300, "estimates")
    measured = {stamp - DELAY_NS for stamp in vehicle.driven}
    assert set(vehicle.stamps()) <= measured


def test_a_model_with_a_delay_gives_late_forces_at_the_stamps_of_its_samples(
    vehicle: Vehicle, start: Start, namespace: str, tmp_path: Path
) -> None:
    model = replace(delayed_damper(0.003, max_gap_s=0.3), band=BAND)
    late, bands = (hear(vehicle, topic) for topic in TOPICS)
    lossless = lossless_topics(namespace, ["joint_states", "stamped_current"], ["observer/estimate", *TOPICS])
    given = {"max_age_s": 0.0, "wait_for_current_s": 10.0, **STAMPED_CURRENT, **lossless}
    start(model=saved(model, tmp_path), **given)
    vehicle.meets_node(DELAYED)
    positions, held, offline = jittered_positions(2000), currents(2000), Offline(model)
    vehicle.publish_burst(positions, held, is_in_order=True)
    expected = offline.take(positions, held)
    wait(lambda: len(bands) >= len(late) >= len(expected), "all delayed estimates")
    assert [(stamp_of(message), numbers_of(message)) for message in late] == list(expected.items())
    assert [stamp_of(message) for message in bands] == list(expected)
    assert len(expected) > 1500
    for message, band in zip(late, bands, strict=True):
        assert (list(message.name), message.header.frame_id) == ([JOINT], "chassis")
        assert band.effort[0] == message.effort[0] - offline.half_widths[stamp_of(band)]
    assert not vehicle.estimates
    vehicle.hears_value("delay_s", "0.003")
    vehicle.hears_value("delayed forces estimated", str(len(expected)))


def test_the_topics_are_there_while_a_model_with_a_delay_is(
    vehicle: Vehicle, start: Start, namespace: str, tmp_path: Path
) -> None:
    """The model changes without a delay, to one, to a longer one and back; each sample is estimated at most once."""

    def offered() -> list[int]:
        return [vehicle.node.count_publishers(topic) for topic in TOPICS]

    late = hear(vehicle, DELAYED)
    given = lossless_topics(namespace, ["joint_states"], ["observer/estimate", *TOPICS]) | {"current.constant": 0.5}
    start(model=saved(plain_damper(**NO_GAP), tmp_path), max_age_s=0.0, **given)
    vehicle.meets_node()
    with vehicle.driving(contiguous=True):
        for name, delay_s in (("short", 0.003), ("long", 0.02)):
            assert offered() == ([1, 1] if late else [0, 0])
            model, before = delayed_damper(delay_s, **NO_GAP), len(late)
            assert vehicle.sets("model", str(saved(model, tmp_path, name))).successful
            vehicle.hears_value("model sha256", model.digest())
            wait(lambda before=before: len(late) > before + 300, "delayed estimates")
        vehicle.hears_value("delay_s", "0.02")
        assert vehicle.sets("model", str(saved(damper_with_past(0.85, **NO_GAP), tmp_path, "back"))).successful
        wait(lambda: offered() == [0, 0], "the topics are withdrawn")
    wait(lambda: stamp_of(vehicle.estimates[-1]) == vehicle.driven[-1], "the last estimate")
    stamps = [stamp_of(message) for message in late]
    expected = vehicle.driven[vehicle.driven.index(stamps[0]) :]
    assert stamps == expected[: len(stamps)]
    assert len(set(vehicle.stamps())) == len(vehicle.stamps())


def costs_of(vehicle: Vehicle) -> list[float]:
    """Return the running costs [%] that were heard."""
    values = [v.value for s in list(vehicle.statuses) for v in s.values if v.key == "running cost J [%]"]
    return [float(value) for value in values if re.fullmatch(r"[0-9.]+", value)]


def test_the_running_cost_takes_the_delayed_estimates(vehicle: Vehicle, start: Start, tmp_path: Path) -> None:
    late = hear(vehicle, DELAYED)
    start(model=saved(delayed_damper(0.003, **NO_GAP), tmp_path), cost_window_s=3, cost_warn_J=50.0)
    vehicle.meets_node(DELAYED)
    with vehicle.driving():
        wait(lambda: bool(late), "a delayed estimate")
        with vehicle.measuring(1.0, late):
            wait(lambda: any(0.0 <= cost < 1.0 for cost in costs_of(vehicle)), "a running cost below 1 %")


TOPIC = "observer/estimate_band"


@pytest.fixture
def heard(vehicle: Vehicle) -> list[JointState]:
    """Return a list that the bands are kept in."""
    bands: list[JointState] = []
    vehicle.node.create_subscription(JointState, TOPIC, bands.append, DEEP)
    return bands


def test_the_band_surrounds_each_estimate(
    vehicle: Vehicle, heard: list[JointState], start: Start, tmp_path: Path
) -> None:
    replace(plain_damper(), band=BAND).save(tmp_path / "model.json")
    start(model=tmp_path / "model.json")
    vehicle.meets_node()
    vehicle.drive_until(lambda: len(heard) > 1000, "bands")
    first_ns = stamp_of(heard[0])  # a topic that is matched later misses the first ones

    def find_pairs() -> list[tuple[JointState, JointState]]:
        bands = {stamp_of(one): one for one in list(heard)}
        estimates = [one for one in list(vehicle.estimates) if stamp_of(one) >= first_ns]
        pairs = [(one, bands[stamp_of(one)]) for one in estimates if stamp_of(one) in bands]
        return pairs if len(pairs) == len(bands) == len(estimates) else []

    for estimate, band in wait_until(find_pairs, "a band for each estimate"):
        assert (stamp_of(band), band.header.frame_id) == (stamp_of(estimate), estimate.header.frame_id)
        assert list(band.name) == [f"{JOINT}_lower", f"{JOINT}_upper"]
        lower, upper = band.effort
        assert lower < estimate.effort[0] < upper
        assert 0.5 * (lower + upper) == pytest.approx(estimate.effort[0], abs=1e-6)
        assert not band.position and not band.velocity


def test_the_band_is_withheld_with_the_estimate(
    vehicle: Vehicle, heard: list[JointState], start: Start, tmp_path: Path
) -> None:
    replace(plain_damper(), band=BAND).save(tmp_path / "model.json")
    start(model=tmp_path / "model.json")
    vehicle.meets_node()
    vehicle.drive_until(lambda: len(heard) > 100, "bands")
    with vehicle.driving(position=lambda time_s: nan):
        vehicle.hears("position is not finite", None)
        fails = vehicle.driven[-1]
        vehicle.hears("position is not finite", None, len(vehicle.statuses))
    recovers = time.time_ns()
    vehicle.drive_until(lambda: stamp_of(heard[-1]) > recovers, "bands again")
    assert not [band for band in heard if fails < stamp_of(band) < recovers]
