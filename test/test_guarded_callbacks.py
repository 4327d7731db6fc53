"""Every callback of the nodes runs behind the guard, as the sources show."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
GUARDED_NODE = ROOT / "ces_observer" / "nodes" / "guarded_node.py"
SOURCES = [
    *sorted((ROOT / "ces_observer" / "nodes").glob("*.py")),
    *sorted((ROOT / "ces_rig" / "live").glob("*.py")),
    ROOT / "ces_cli" / "identify" / "node.py",
]
# Registered by methods that GuardedNode guards; a node has no other way to them.
BY_THE_NODE = {
    "create_subscription",
    "create_service",
    "create_timer",
    "add_on_set_parameters_callback",
    "add_post_set_parameters_callback",
}
# Not guarded by GuardedNode: the callbacks must be the result of `guard.wrap`.
BY_HAND = {"create_jump_callback", "SubscriptionEventCallbacks"}
WORDS = ("pre_callback", "post_callback", "deadline", "liveliness")  # of their callbacks
# Neither: such a callback would have to be guarded first. Clients are polled.
NOT_AT_ALL = {
    "create_guard_condition",
    "create_rate",
    "create_task",
    "create_node",
    "add_pre_set_parameters_callback",
    "add_done_callback",
    "add_waitable",
    "on_shutdown",
    "PublisherEventCallbacks",
    "Timer",
}


def calls(path: Path) -> Iterator[tuple[str, ast.Call]]:
    """Yield each call in a file with the last part of the called name."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func).rpartition(".")[2], node


def test_no_callback_passes_by_the_guard_or_is_a_coroutine() -> None:
    kinds = (ast.AsyncFunctionDef, ast.Await, ast.AsyncFor, ast.AsyncWith)
    for path in SOURCES:
        assert not [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, kinds)], path
        for name, call in calls(path):
            assert name not in NOT_AT_ALL, f"{path}: {ast.unparse(call)}"
            callbacks = [word.value for word in call.keywords if word.arg in WORDS]
            if name in BY_HAND:
                assert callbacks and all(".guard.wrap(" in ast.unparse(callback) for callback in callbacks), path


def test_each_node_is_a_guarded_one() -> None:
    """Only GuardedNode derives from rclpy's; the four programs' nodes derive from it."""
    bases = {
        node.name: [ast.unparse(base) for base in node.bases]
        for path in SOURCES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    }
    assert [name for name, of in bases.items() if "Node" in of] == ["GuardedNode"]
    assert bases["TableNode"] == ["GuardedNode"]
    assert {name for name, of in bases.items() if "TableNode" in of} == {"ManagedNode", "Rig", "IdentifyNode"}
    assert {name for name, of in bases.items() if "ManagedNode" in of} == {"Observer", "Controller"}


def test_the_guarded_node_guards_each_of_them() -> None:
    (kind,) = [
        node for node in ast.parse(GUARDED_NODE.read_text(encoding="utf-8")).body if isinstance(node, ast.ClassDef)
    ]
    methods = {one.name: ast.unparse(one) for one in kind.body if isinstance(one, ast.FunctionDef)}
    assert {name for name, text in methods.items() if "self.guard.wrap(" in text} == BY_THE_NODE
