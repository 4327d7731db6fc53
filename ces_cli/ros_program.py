"""Entry point of `ros2 run ces_observer NAME` for every program of `ces`; the executable's file name is NAME.

With `--ros-args`, which ros2 launch always adds, `identify` and `rig` run as nodes; `rig` also without any arguments.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import NoReturn

from ces_cli import main as ces

# what no node of a vehicle imports
DESK = ("numpy", "scipy", "numba", "jinja2", "rich", "yaml", "joblib", "rosbags", "mcap")
NODES = {"identify": "ces_cli.identify.node", "rig": "ces_rig.live.node"}


def main() -> int:
    """Run the node or program named by this process's executable; returns the exit status."""
    name, words = Path(sys.argv[0]).name, sys.argv[1:]
    if missing := [library for library in DESK if find_spec(library) is None]:
        cure = "run 'rosdep install --from-paths src --ignore-src' without CES_VEHICLE, and 'pip install rosbags mcap'"
        print(f"ces {name}: error: not installed: {', '.join(missing)}, as on a vehicle; {cure}", file=sys.stderr)
        return 2
    if not is_node(name, words):
        return ces.main([name, *words])
    signal.signal(signal.SIGINT, _end_start)
    status: int = import_module(NODES[name]).main(sys.argv)
    return status


def _end_start(number: int, frame: FrameType | None) -> NoReturn:
    """End in order at Ctrl-C while modules are imported; the node installs its own handler later."""
    os._exit(0)


def is_node(name: str, words: Sequence[str]) -> bool:
    """Return whether NAME runs as a node with these arguments."""
    return name in NODES and (ces.ROS_ARGS in words or (name == "rig" and not words))
