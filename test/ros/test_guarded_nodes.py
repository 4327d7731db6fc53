"""Every callback of the four nodes as they run is guarded, rclpy's own included."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

import rclpy
from conftest import new_namespace
from node_process import ROOT, ros_args

from ces_cli.identify.node import IdentifyNode, StopRequests
from ces_observer.nodes.controller import Controller
from ces_observer.nodes.executors import START_ERRORS, make_executor
from ces_observer.nodes.guard import GUARDED
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.observer import Observer
from ces_rig.live.node import Rig

OF_RCL = "get_type_description"  # made by rclpy past the node's methods, answered by rcl: the executor's loop guards it
MODEL = {"model_topic": "models", "use_sim_time": True}
NODES: dict[str, tuple[Callable[[], GuardedNode], dict[str, object]]] = {
    "observer": (Observer, {**MODEL, "dampers": "[front, rear]", "front.name": "a", "rear.name": "b"}),
    "controller": (Controller, MODEL),
    "rig": (Rig, {"drive": "vehicle"}),
    "identify": (lambda: IdentifyNode(StopRequests()), {"bags": f"[{ROOT / 'bags' / 'noise'}]"}),
}


@contextmanager
def built(name: str, model: Path, folder: Path) -> Iterator[GuardedNode]:
    make, parameters = NODES[name]
    given = {"out": folder / "out.json"} if name == "identify" else {} if name == "rig" else {"model": model}
    rclpy.init(args=ros_args(new_namespace(), {**parameters, **given}))
    try:
        node = make()
        yield node
        if isinstance(node, IdentifyNode):
            node.end()
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


def callbacks(node: GuardedNode) -> Iterator[tuple[str, Any]]:
    """Yield all callbacks of a node, by name."""
    yield from ((one.topic_name, one.callback) for one in node.subscriptions)
    yield from ((one.srv_name, one.callback) for one in node.services)
    yield from ((f"timer {one.timer_period_ns}", one.callback) for one in node.timers)
    yield from (("check of parameters", one) for one in node._on_set_parameters_callbacks)
    yield from (("parameters set", one) for one in node._post_set_parameters_callbacks)


@pytest.mark.parametrize("name", NODES)
def test_each_callback_is_guarded(name: str, model_path: Path, tmp_path: Path) -> None:
    with built(name, model_path, tmp_path) as node:
        found = dict(callbacks(node))
        assert len(found) >= 8  # six services of parameters at least, a check of use_sim_time, a timer
        assert [one for one, callback in found.items() if not hasattr(callback, GUARDED) and OF_RCL not in one] == []
        assert not list(node.clients) and not list(node.guards)
        assert all(one.raw for one in node.subscriptions)
        groups = [one.callback_group for one in (*node.subscriptions, *node.timers, *node.services)]
        assert len(set(groups)) == len(groups)


def test_an_executor_that_this_rclpy_lacks_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from ces_observer.nodes import executors

    monkeypatch.setattr(executors, "EventsExecutor", None)
    with pytest.raises(START_ERRORS, match="this rclpy has no EventsExecutor: set auto or single"):
        make_executor("events")
