"""`ces --version`: the versions of the suite, Python and its packages, of ROS 2, and of the machine."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from typing import Any

from ces_cli.terminal.outputs import print_document
from ces_observer import __version__
from ces_observer.errors import CesError

NAME = "ces_observer"
DEVELOPMENT = ("dev", "test", "docs", "bench", "fuzz")  # extras that no program uses
THREADS = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")


def main(argv: Sequence[str] | None = None) -> int:
    """Print the versions; returns the exit status. Raises CesError for words other than --json."""
    words = list(argv or ())
    if words not in ([], ["--json"]):
        raise CesError(f"found '{' '.join(words)}'; expected nothing more, or --json")
    if words:
        print_document("version", find_versions())
    else:
        print("\n".join([f"{NAME} {__version__}", *_lines(find_versions())]))
    return 0


def find_versions() -> dict[str, Any]:
    """Return the versions by the suite's own metadata: None if absent; no packages if it was never installed."""
    packages: dict[str, str | None] = {}
    extras: dict[str, dict[str, str | None]] = {}
    try:
        lines = metadata.requires(NAME) or []
    except metadata.PackageNotFoundError:
        lines = []
    for line in lines:
        name = re.split(r"[^\w.-]", line)[0]
        extra = re.search(r"extra == ['\"]([\w-]+)['\"]", line)
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            version = None
        if extra is None:
            packages[name] = version
        elif extra[1] not in DEVELOPMENT:
            extras.setdefault(extra[1], {})[name] = version
    return {
        "python": platform.python_version(),
        "executable": sys.executable,
        "platform": platform.platform(),
        "processors": os.cpu_count() or 1,
        "threads": {name: os.environ.get(name) for name in THREADS},
        "ros": os.environ.get("ROS_DISTRO"),
        "rmw": os.environ.get("RMW_IMPLEMENTATION"),
        "packages": packages,
        "extras": extras,
    }


def _lines(versions: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line for each fact; absent packages are named as such, with their extra."""
    yield f"python        {versions['python']}  ({versions['executable']})"
    yield f"platform      {versions['platform']}, {versions['processors']} processors"
    distro, rmw = versions["ros"], versions["rmw"] or "default middleware"
    yield f"ROS 2         {f'{distro}, {rmw}' if distro else 'not sourced'}"
    threads = ", ".join(f"{name}={count}" for name, count in versions["threads"].items() if count)
    yield f"threads       {threads or 'not limited by the environment'}"
    if not versions["packages"]:
        yield "packages      unknown: ces_observer runs from its source folder and is not installed"
    yield from (f"{name:<13} {version or 'absent'}" for name, version in versions["packages"].items())
    told = set(versions["packages"])
    for extra, names in versions["extras"].items():
        for name in (name for name in names if name not in told):
            yield f"{name:<13} {names[name] or f'absent (optional: pip install ces_observer[{extra}])'}"
        told |= names.keys()
