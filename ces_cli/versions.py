"""`ces --version`: the versions of the suite, Python and its packages, of ROS 2, and of the machine."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Sequence
from importlib import metadata
from typing import Any

from ces_cli.terminal.outputs import print_document
from ces_observer import __version__
from ces_observer.errors import CesError

NAME = "ces_observer"
DEVELOPMENT = ("dev", "test", "docs", "bench", "fuzz")  # extras that no program uses


def main(argv: Sequence[str] | None = None) -> int:
    """Print the versions; returns the exit status. Raises CesError for words other than --json."""
    words = list(argv or ())
    if words not in ([], ["--json"]):
        raise CesError(f"found '{' '.join(words)}'; expected nothing more, or --json")
    facts = find_versions()
    if words:
        print_document("version", facts)
        return 0
    packages = facts.pop("packages")
    rows = {**facts, **packages}
    print("\n".join([f"{NAME} {__version__}", *(f"{name:<13} {fact or 'absent'}" for name, fact in rows.items())]))
    return 0


def find_versions() -> dict[str, Any]:
    """Return the versions by the suite's own metadata: None if absent; no packages if it was never installed."""
    try:
        lines = metadata.requires(NAME) or []
    except metadata.PackageNotFoundError:
        lines = []
    used = [line for line in lines if not any(f'extra == "{extra}"' in line for extra in DEVELOPMENT)]
    return {
        "python": f"{platform.python_version()} ({sys.executable})",
        "platform": f"{platform.platform()}, {os.cpu_count() or 1} processors",
        "ROS 2": os.environ.get("ROS_DISTRO"),
        "middleware": os.environ.get("RMW_IMPLEMENTATION"),
        "packages": {name: _find_version(name) for name in (re.split(r"[^\w.-]", line)[0] for line in used)},
    }


def _find_version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
