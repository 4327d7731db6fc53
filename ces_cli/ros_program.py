"""Entry of what `ros2 run ces_observer NAME` finds beside the observer and the controller: the file's name is NAME.

NAME is a program of `ces`. Two of them are nodes, too: with `--ros-args`, which ros2 launch always gives, `identify`
runs as a node, and so does `rig`, which is one without any arguments as well.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from ces_cli import main as ces

NODES = {"identify": "ces_cli.identify.node", "rig": "ces_rig.live.node"}


def main() -> int:
    """Run the node or program that this process was started as; returns the exit status."""
    name, words = Path(sys.argv[0]).name, sys.argv[1:]
    if not is_node(name, words):
        return ces.main([name, *words])
    status: int = import_module(NODES[name]).main(sys.argv)
    return status


def is_node(name: str, words: Sequence[str]) -> bool:
    """Tell whether NAME with these arguments is meant as a node."""
    return name in NODES and (ces.ROS_ARGS in words or (name == "rig" and not words))
