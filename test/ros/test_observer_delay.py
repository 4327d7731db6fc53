"""A signal's delay in the signals file moves the stamps of its samples back in the observer node."""

from __future__ import annotations

from collections.abc import Callable

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from node_process import NodeProcess
from vehicle import Vehicle

DELAY_NS = 100_000_000


def test_estimates_have_the_stamps_of_when_positions_were_measured(
    vehicle: Vehicle, start: Callable[..., NodeProcess]
) -> None:
    start(**{"position.delay": DELAY_NS * 1e-9})
    vehicle.meets_node()
    vehicle.drive_until(lambda: len(vehicle.estimates) > 300, "estimates")
    measured = {stamp - DELAY_NS for stamp in vehicle.driven}
    assert set(vehicle.stamps()) <= measured
