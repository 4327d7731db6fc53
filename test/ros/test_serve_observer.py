"""The live view of `ces serve` on a real ROS 2: it hears an observer, its band and health, and publishes nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from bands import BAND
from damper_models import plain_damper
from node_process import NodeProcess
from vehicle import JOINT, Vehicle, wait

from ces_serve.live.link import ObserverLink, find_python

Start = Callable[..., NodeProcess]


@contextmanager
def listening(observer: str) -> Iterator[list[dict[str, Any]]]:
    """Yield a list that the messages of a link are kept in."""
    heard: list[dict[str, Any]] = []
    link = ObserverLink(observer)
    messages = link.messages()
    ended = False

    def listen() -> None:
        for message in messages:
            if ended:
                return
            if message:
                heard.append(message)

    thread = Thread(target=listen)
    thread.start()
    try:
        yield heard
    finally:
        ended = True
        thread.join()
        messages.close()
        link.close()


def batches(heard: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [message["batch"] for message in list(heard) if "batch" in message]


def batch_rate(heard: list[dict[str, Any]]) -> float:
    """Return the batches a second during the next two seconds."""
    before, began = len(batches(heard)), time.monotonic()
    time.sleep(2.0)
    return (len(batches(heard)) - before) / (time.monotonic() - began)


@pytest.fixture
def banded(tmp_path: Path) -> Path:
    path = tmp_path / "model.json"
    replace(plain_damper(max_gap_s=0.3), band=BAND).save(path)
    return path


def test_a_running_observer_is_heard_with_band_and_health(vehicle: Vehicle, start: Start, banded: Path) -> None:
    assert find_python() is not None
    observer = f"{vehicle.namespace}/observer"
    with listening(observer) as heard, listening("some_other") as others:
        wait(lambda: {"topics": []} in heard, "the process has looked for observers")
        start(model=banded)
        vehicle.meets_node()
        with vehicle.driving():
            wait(lambda: {"topics": [f"{observer}/estimate"]} in heard, "the observer is found")
            wait(lambda: bool(batches(heard)), "a batch of estimates")
            first = len(batches(heard))
            wait(lambda: 10.0 < batch_rate(heard) <= 25.0, "the rate of batches, when nothing holds them up")
        statuses = [message["status"] for message in heard if "status" in message]
        listeners = [node for node in vehicle.node.get_node_names() if node.startswith("ces_serve_")]
        offered = [
            topic
            for node in listeners
            for topic, _ in vehicle.node.get_publisher_names_and_types_by_node(node, "/")
            if topic != "/parameter_events"  # rclpy's own, on which nothing is sent
        ]
    assert len(listeners) == 2 and offered == []
    assert others == [{"topics": []}]
    estimates = {(message.header.stamp.sec, message.header.stamp.nanosec): message for message in vehicle.estimates}
    for batch in batches(heard)[first:]:
        for stamp, force, lower, upper in zip(
            batch["time_ns"], batch["force"], batch["lower"], batch["upper"], strict=True
        ):
            assert force == estimates[divmod(int(stamp), 10**9)].effort[0]
            assert lower is None or lower < force < upper
    assert sum(lower is not None for batch in batches(heard)[first:] for lower in batch["lower"]) > 100
    assert {status["name"] for status in statuses} == {f"{observer}: {JOINT}"}
    assert any("estimating" in status["message"] for status in statuses)
