"""The layouts for PlotJuggler and Foxglove: what they show is in what `ces replay` writes or the observer tells.

Each tool's way of spelling a number in a message is modelled here, on messages read back from a bag; whatever a layout
names must then be found, be a number where it is plotted, and carry values.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
from rosbags.highlevel import AnyReader
from shared_results import SharedResults

from ces_cli.main import main
from ces_observer.current_hold import ConstantCurrent
from ces_observer.damper_observer import DamperObserver
from ces_observer.health.diagnostics import NodeFacts, Status
from ces_observer.health.health import Health
from ces_observer.health.running_cost import RunningCost
from ces_observer.model import load_model

ROOT = Path(__file__).resolve().parent.parent
FOXGLOVE = json.loads((ROOT / "config" / "foxglove.json").read_text())
PLOTJUGGLER = ElementTree.parse(ROOT / "config" / "plotjuggler.xml").getroot()
MS = 1_000_000
JOINT, NODE, DETAILS = "rear_damper", "/observer", "/observer/details"
NUMBER = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)?")


@pytest.fixture(scope="module")
def messages(shared_model: SharedResults, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, Any]]:
    """Return by topic the type and the last message: of a replayed bag, and the diagnostics of an observer."""
    replayed = tmp_path_factory.mktemp("replay") / "replayed"
    assert main(["replay", str(shared_model.model), str(ROOT / "bags" / "road"), "--out", str(replayed)]) == 0
    with AnyReader([replayed]) as bag:
        found = {c.topic: (c.msgtype, bag.deserialize(raw, c.msgtype)) for c, _, raw in bag.messages()}
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    told = zip(("/diagnostics", DETAILS), diagnostics(shared_model.model), strict=True)
    return {**found, **{topic: (kind, array) for topic, array in told}}


def diagnostics(model: Path) -> Iterator[SimpleNamespace]:
    """Yield the tasks and the details of a damper that has run for two seconds beside a measured force."""
    damper = DamperObserver(load_model(model), ConstantCurrent(0.5), 0.0)
    health = Health(damper, {"model": str(model)}, cost=RunningCost(window_s=1))
    for k in range(2000):
        force, now_ns = 100.0 * math.sin(0.01 * k), k * MS
        damper.step(now_ns, 0.01 * math.sin(0.01 * k), now_ns)
        for stream in (health.position, health.current, health.force):
            stream.take(now_ns, now_ns + MS)
        health.latency.take(MS)
        assert health.cost is not None
        health.cost.add_estimate(now_ns, force)
        health.cost.add_measured(now_ns, 1.1 * force)
        if k % 500 == 499:
            health.roll(0.5, now_ns)
    report = health.report("", NodeFacts())
    yield SimpleNamespace(status=[as_message(f"{JOINT} {name}", status) for name, status in report.tasks])
    yield SimpleNamespace(status=[as_message(JOINT, report.status)])


def as_message(name: str, status: Status) -> SimpleNamespace:
    values = [SimpleNamespace(key=key, value=value) for key, value in status.values]
    told = {"level": status.level, "message": status.message, "values": values}
    return SimpleNamespace(name=f"{NODE}: {name}", hardware_id=JOINT, **told)


# -- PlotJuggler: topic/field/field, but joints by name, and diagnostics by hardware id, name and key


def series(topic: str, kind: str, message: Any) -> Iterator[tuple[str, float]]:
    if kind == "sensor_msgs/msg/JointState":
        for field in ("position", "velocity", "effort"):
            for joint, value in zip(message.name, getattr(message, field), strict=False):
                yield f"{topic}/{joint}/{field}", float(value)
    elif kind == "diagnostic_msgs/msg/DiagnosticArray":
        for status in message.status:
            where = f"{topic}/{status.hardware_id}/{status.name}"
            yield f"{where}/level", float(status.level)
            yield from (
                (f"{where}/{pair.key}", float(pair.value)) for pair in status.values if NUMBER.fullmatch(pair.value)
            )
    else:
        yield from leaves(topic, message)


def leaves(where: str, message: Any) -> Iterator[tuple[str, float]]:
    for name in (n for n in vars(message) if not n.startswith("_")):
        value = getattr(message, name)
        if isinstance(value, int | float):
            yield f"{where}/{name}", float(value)
        elif hasattr(value, "__dict__"):
            yield from leaves(f"{where}/{name}", value)


def test_every_curve_of_plotjuggler_has_data(messages: dict[str, tuple[str, Any]]) -> None:
    there = dict(row for topic, (kind, message) in messages.items() for row in series(topic, kind, message))
    curves = list(PLOTJUGGLER.iter("curve"))
    shown = [curve.attrib.get(key) for curve in curves for key in ("curve_x", "curve_y")]
    shown += [curve.attrib["name"] for curve in curves if "curve_x" not in curve.attrib]
    assert {name for name in shown if name} - set(there) == set()
    assert all(math.isfinite(there[name]) for name in shown if name)


def test_plotjuggler_subscribes_to_what_it_shows(messages: dict[str, tuple[str, Any]]) -> None:
    (chosen,) = PLOTJUGGLER.iter("selected_topics")
    shown = {row.attrib["name"] for row in PLOTJUGGLER.iter("curve")}
    assert set(chosen.attrib["value"].split(";")) == set(messages) - {DETAILS}
    assert all(any(name.startswith(f"{topic}/") for name in shown) for topic in set(messages) - {DETAILS})


# -- Foxglove: message paths, /topic.field[index]{key==value}.field


PART = re.compile(r"\.(?P<name>\w+)|\[(?P<slice>\d+|:)\]|\{(?P<key>\w+)==\"(?P<value>[^\"]*)\"\}")


def resolved(path: str, messages: dict[str, tuple[str, Any]]) -> list[Any]:
    """Return what a message path yields; fails if a part of it is not understood or there is nothing."""
    topic, rest = re.fullmatch(r"(/[\w/]+)(.*)", path, re.DOTALL).groups()  # type: ignore[union-attr]
    found, position = [messages[topic][1]], 0
    while position < len(rest):
        part = PART.match(rest, position)
        assert part, f"{path}: not understood from {rest[position:]}"
        found = [value for one in found for value in taken(part, one)]
        position = part.end()
    return found


def taken(part: re.Match[str], value: Any) -> list[Any]:
    if part["name"]:
        return [getattr(value, part["name"])]
    if part["slice"]:
        return list(value) if part["slice"] == ":" else [value[int(part["slice"])]]
    return [value] if getattr(value, part["key"]) == part["value"] else []


def test_every_path_of_foxglove_has_data(messages: dict[str, tuple[str, Any]]) -> None:
    for name, config in FOXGLOVE["configById"].items():
        paths = [path["value"] for path in config.get("paths", [])]
        paths += [config["xAxisPath"]["value"]] if "xAxisPath" in config else []
        for path in paths:
            (value,) = resolved(path, messages)
            assert value if name.startswith("StateTransitions!") else math.isfinite(float(value)), path


def test_paths_with_header_stamps_have_headers(messages: dict[str, tuple[str, Any]]) -> None:
    plotted = [path for config in FOXGLOVE["configById"].values() for path in config.get("paths", [])]
    for path in plotted:
        message = messages[re.match(r"/[\w/]+", path["value"])[0]][1]  # type: ignore[index]
        assert path["timestampMethod"] in ("headerStamp", "receiveTime")
        assert path["timestampMethod"] == "receiveTime" or hasattr(message, "header")


def test_every_panel_of_foxglove_is_shown_once() -> None:
    configs = FOXGLOVE["configById"]
    trees = [FOXGLOVE["layout"], *(tab["layout"] for config in configs.values() for tab in config.get("tabs", []))]
    assert sorted(re.findall(r'"(\w+!\w+)"', json.dumps(trees))) == sorted(configs)


def test_the_health_panel_selects_the_observers_details(messages: dict[str, tuple[str, Any]]) -> None:
    chosen = FOXGLOVE["configById"]["DiagnosticStatusPanel!observer"]
    _, array = messages[chosen["topicToRender"]]
    assert (chosen["selectedHardwareId"], chosen["selectedName"]) in [(s.hardware_id, s.name) for s in array.status]
    assert (chosen["topicToRender"], FOXGLOVE["configById"]["DiagnosticSummary!all"]["topicToRender"]) == (
        DETAILS,
        "/diagnostics",
    )
