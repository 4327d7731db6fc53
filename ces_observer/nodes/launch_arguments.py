"""Checks of a launch file's arguments before any node starts: mistakes that ros2 launch itself passes over."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path

from ces_observer.errors import CesError


def check_names(launch_file: str, known: Collection[str], words: Sequence[str] | None = None) -> None:
    """Raise CesError for an argument NAME:=VALUE in `words`, by default the command line, that is not `known`.

    Nothing is checked if `launch_file` is not named there: another launch file includes it, and has its own arguments.
    """
    given = sys.argv if words is None else words
    if Path(launch_file).name not in (Path(word).name for word in given):
        return
    for name in (word.partition(":=")[0] for word in given if ":=" in word):
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"expected one of {', '.join(known)}"
            raise CesError(f"unknown launch argument '{name}'; {hint}")


def check_files(files: Mapping[str, str]) -> None:
    """Raise CesError unless each of the `files`, by the name of its argument, exists."""
    for argument, path in files.items():
        if not Path(path).expanduser().is_file():
            raise CesError(f"launch argument '{argument}': {path}: no such file")
