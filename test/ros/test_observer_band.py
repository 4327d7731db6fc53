"""The band on a real ROS 2: published beside each estimate of a model that has one, and withheld with the estimate."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from math import nan
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from bands import BAND
from damper_models import plain_damper
from node_process import NodeProcess
from patience import wait_until
from sensor_msgs.msg import JointState
from vehicle import DEEP, JOINT, Vehicle, stamp_of

TOPIC = "observer/estimate_band"
Start = Callable[..., NodeProcess]


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
