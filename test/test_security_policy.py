"""The security policy without ROS: its form, least privilege, and the topics' names beside those in the sources.

test/ros/test_security.py enforces it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from ces_observer.signals import DEFAULTS

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "config" / "security"
INCLUDE = "{http://www.w3.org/2001/XInclude}include"
NODES = ("observer", "controller", "rig", "identify")
RULES = {"topics": {"publish", "subscribe"}, "services": {"reply", "request"}}  # of sros2's schema, version 0.2.0
MAKERS = (
    "create_publisher",
    "create_subscription",
    "create_service",
    "create_client",
    "_publisher",
    "_subscribe",
    "_make_patched",
    "_make_wrench",
    "EstimateOutput",
)
PROFILES = list(ElementTree.parse(FOLDER / "policy.xml").getroot().iter("profile"))
COMMON = ElementTree.parse(FOLDER / "node.xml").getroot()


def blocks() -> list[ElementTree.Element]:
    return [block for profile in (COMMON, *PROFILES) for block in profile if block.tag != INCLUDE]


def names(element: ElementTree.Element) -> set[str]:
    """Return the topics and services that a profile lists itself."""
    return {str(one.text) for block in element if block.tag != INCLUDE for one in block}


def test_each_node_has_one_enclave() -> None:
    root = ElementTree.parse(FOLDER / "policy.xml").getroot()
    assert (root.tag, root.attrib) == ("policy", {"version": "0.2.0"})
    paths = [enclave.get("path") for enclave in root.iterfind("enclaves/enclave")]
    assert paths == [f"/ces_observer/{name}" for name in NODES]
    assert [(profile.get("ns"), profile.get("node")) for profile in PROFILES] == [("/", name) for name in NODES]
    for profile in PROFILES:
        assert [block.get("href") for block in profile if block.tag == INCLUDE] == ["node.xml"]


def test_blocks_are_of_the_schema() -> None:
    for block in blocks():
        assert set(block.attrib) <= RULES[block.tag] and set(block.attrib.values()) == {"ALLOW"}
        assert len(block) and all(one.tag == block.tag[:-1] for one in block)


def test_nothing_is_granted_wholesale() -> None:
    """A wildcard stands only for a damper's name below the observer's own; no block is for both directions."""
    assert {name for element in (COMMON, *PROFILES) for name in names(element) if "*" in name} == {
        "~/*/estimate",
        "~/*/estimate_band",
        "~/*/estimate_delayed",
        "~/*/estimate_delayed_band",
        "~/*/model_status",
        "~/*/reload_model",
    }
    assert all(len(block.attrib) == 1 and "request" not in block.attrib for block in blocks())
    for profile in PROFILES:
        mine = sorted(str(one.text) for block in profile if block.tag != INCLUDE for one in block)
        assert len(mine) == len(set(mine)) and not set(mine) & (names(COMMON) - {"/clock"})


def test_only_the_rig_stands_in_for_sensors_and_only_the_controller_commands() -> None:
    publishers: dict[str, set[str]] = {}
    for profile in PROFILES:
        for block in profile.iterfind("topics[@publish]"):
            for one in block:
                publishers.setdefault(str(one.text), set()).add(str(profile.get("node")))
    assert all(publishers[signal["topic"]] == {"rig"} for signal in DEFAULTS.values())
    assert publishers["valve_command"] == {"controller"}


def literals() -> Iterator[str]:
    """Yield the names that the sources give to topics and services where they make them, a damper's name as `*`."""
    for package in ("ces_observer", "ces_rig", "ces_cli"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute | ast.Name):
                    name = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
                    if name in MAKERS:
                        topics = list(filter(None, map(written, node.args)))
                        yield from topics
                        yield from (f"{topic}_band" for topic in topics if name == "EstimateOutput")


def written(argument: ast.expr) -> str:
    """Return the end of a text, or of a text with a name put in; empty for anything else."""
    part = argument.values[-1] if isinstance(argument, ast.JoinedStr) else argument
    return part.value.removeprefix("~/") if isinstance(part, ast.Constant) and isinstance(part.value, str) else ""


def test_what_the_sources_make_is_granted_and_the_other_way_round() -> None:
    made = set(literals())
    assert {"reload_model", "estimate", "valve_command", "/diagnostics"} <= made
    granted = {name.removeprefix("~/").removeprefix("*/") for element in (COMMON, *PROFILES) for name in names(element)}
    assert not made - granted
    others = {signal["topic"] for signal in DEFAULTS.values()} | {"observer/estimate"}
    assert not granted - made - others - {name.removeprefix("~/") for name in names(COMMON)}


def test_the_documentation_tells_of_each_enclave() -> None:
    page = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
    assert [name for name in NODES if f"/ces_observer/{name}" not in page] == []
