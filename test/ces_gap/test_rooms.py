"""The rooms of ces_gap import only downward: imports have no cycle."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2] / "ces_gap"


def imported_rooms(path: Path) -> set[str]:
    """Return the rooms that a module imports from; a top module counts as a room."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    modules = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    return {module.split(".")[1] for module in modules if module.startswith("ces_gap.")}


def test_rooms_import_only_downward() -> None:
    arrows: dict[str, set[str]] = {}
    for path in ROOT.rglob("*.py"):
        room = path.relative_to(ROOT).with_suffix("").parts[0]
        arrows.setdefault(room, set()).update(imported_rooms(path) - {room})
    order = list(TopologicalSorter(arrows).static_order())  # raises CycleError, which names the cycle
    assert order.index("trace") < order.index("effects") < order.index("baseline") < order.index("inference")
    assert order.index("inference") < order.index("diagnosis") < order.index("pipeline")
