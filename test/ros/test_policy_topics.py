"""The security policy beside the nodes themselves: it grants what they have, and nothing that none of them ever has."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

import rclpy
from damper_models import delayed_damper
from node_process import ROOT, NodeProcess
from rclpy.node import Node, NodeNameNonExistentError
from vehicle import wait

FOLDER = ROOT / "config" / "security"
FRONT = {"dampers": "[front]", "front.position.field": "position[front]"}
SIMULATED = {"use_sim_time": True}
# Each node with what makes it have all of its topics; one may need several processes, each in a namespace of its own.
NODES = {
    "observer": [
        ("ces_observer.nodes.observer", {**SIMULATED, "model_topic": "identify/model"}),
        ("ces_observer.nodes.observer", FRONT),
    ],
    "controller": [
        ("ces_observer.nodes.controller", {**SIMULATED, "feedback": "measured", "model_topic": "identify/model"})
    ],
    "rig": [
        ("ces_rig.live.node", {**SIMULATED, "drive": "vehicle", "publish_clock": True}),
        ("ces_rig.live.node", {"drive": "set_points"}),
    ],
    "identify": [("ces_cli.identify.node", {**SIMULATED, "bags": f"[{ROOT / 'bags' / 'noise'}]", "seconds": 60.0})],
}


@pytest.fixture(scope="module")
def looker() -> Iterator[Node]:
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node("looker", context=context)
    yield node
    node.destroy_node()
    context.shutdown()


def words(namespace: str, parameters: dict[str, object]) -> list[str]:
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    return ["--ros-args", "-r", f"__ns:={namespace}", *given]


def had(looker: Node, name: str, namespace: str) -> set[str]:
    """Return what a node publishes, hears, answers and asks for, as it were in the root namespace."""
    looks: dict[str, Callable[[str, str], list[tuple[str, list[str]]]]] = {
        "publish": looker.get_publisher_names_and_types_by_node,
        "subscribe": looker.get_subscriber_names_and_types_by_node,
        "reply": looker.get_service_names_and_types_by_node,
        "request": looker.get_client_names_and_types_by_node,
    }
    try:
        topics = [(verb, topic) for verb, get in looks.items() for topic, _ in get(name, namespace)]
    except NodeNameNonExistentError:  # not yet
        return set()
    return {f"{verb} {topic.removeprefix(namespace)}" for verb, topic in topics}


def granted() -> dict[str, set[str]]:
    """Return what the policy grants each node, resolved in the root namespace."""
    common = ElementTree.parse(FOLDER / "node.xml").getroot()
    policy = ElementTree.parse(FOLDER / "policy.xml").getroot()
    return {
        str(profile.get("node")): {
            f"{verb} {resolved(str(one.text), str(profile.get('node')))}"
            for block in (*common, *profile)
            for verb, rule in block.attrib.items()
            if rule == "ALLOW" and verb != "href"
            for one in block
        }
        for profile in policy.iter("profile")
    }


def resolved(topic: str, node: str) -> str:
    return topic.replace("~", f"/{node}") if topic.startswith("~") else f"/{topic.lstrip('/')}"


@pytest.fixture(scope="module")
def started(model_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, dict[str, NodeProcess]]]:
    """Start all processes at once; yield those of each node by their namespaces."""
    folder = tmp_path_factory.mktemp("out")
    found: dict[str, dict[str, NodeProcess]] = {name: {} for name in NODES}
    for name, processes in NODES.items():
        for i, (module, parameters) in enumerate(processes):
            command = [sys.executable, "-m", module]
            space = f"/{name}_policy{i}"
            found[name][space] = NodeProcess([*command, *words(space, given(module, parameters, model_path, folder))])
    yield found
    nodes = [node for spaces in found.values() for node in spaces.values()]
    for node in nodes:
        if node.is_running():
            node.interrupt()
    for node in nodes:
        node.kill()


@pytest.mark.parametrize("name", NODES)
def test_a_node_is_granted_what_it_has_and_nothing_else(
    name: str, looker: Node, started: dict[str, dict[str, NodeProcess]]
) -> None:
    grants, nodes = granted()[name], started[name].values()

    def has() -> set[str]:
        return set().union(*(had(looker, name, space) for space in started[name]))

    def unused() -> set[str]:
        present = has()
        return {grant for grant in grants if not any(fnmatchcase(one, grant) for one in present)}

    wait(lambda: not unused() or not all(node.is_running() for node in nodes), "what is granted")
    assert not unused(), [node.ended() for node in nodes if not node.is_running()]
    assert not {one for one in has() if not any(fnmatchcase(one, grant) for grant in grants)}


def given(module: str, parameters: dict[str, object], model: Path, folder: Path) -> dict[str, object]:
    if module == "ces_observer.nodes.observer":
        delayed_damper(0.003).save(folder / "delayed.json")
        return {**parameters, "model": folder / "delayed.json"}
    if module == "ces_cli.identify.node":
        return {**parameters, "out": folder / "model.json"}
    return {**parameters, "model": model} if module.startswith("ces_observer") else parameters
