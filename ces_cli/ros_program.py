"""Entry of the programs that `ros2 run ces_observer NAME` finds: the file's name says which program of `ces` it is."""

from __future__ import annotations

import sys
from pathlib import Path

from ces_cli import main as ces


def main() -> int:
    """Run the program that this process was started as; returns the exit status."""
    return ces.main([Path(sys.argv[0]).name, *sys.argv[1:]])
