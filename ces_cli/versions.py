"""`ces --version`: the versions of the suite, Python and its packages, of ROS 2, and of the machine."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata

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
        print(format_versions(find_versions()))
    return 0


def find_versions() -> dict[str, object]:
    """Return the versions in use; a package that is not installed has None."""
    required, optional = list_packages()
    return {
        "python": platform.python_version(),
        "executable": sys.executable,
        "platform": platform.platform(),
        "processors": os.cpu_count() or 1,
        "threads": {name: os.environ.get(name) for name in THREADS},
        "ros": os.environ.get("ROS_DISTRO"),
        "rmw": os.environ.get("RMW_IMPLEMENTATION"),
        "packages": {name: find_version(name) for name in required},
        "extras": {extra: {name: find_version(name) for name in names} for extra, names in optional.items()},
    }


def format_versions(versions: Mapping[str, object]) -> str:
    """Return the versions as lines of text, the suite's first."""
    return "\n".join([f"{NAME} {__version__}", *_lines(versions)])


def list_packages() -> tuple[list[str], dict[str, list[str]]]:
    """Return the packages that the suite requires, and those of its extras by extra, by its own metadata.

    Both are empty if the suite runs from its source folder and was never installed.
    """
    required: list[str] = []
    optional: dict[str, list[str]] = {}
    try:
        lines = metadata.requires(NAME) or []
    except metadata.PackageNotFoundError:
        lines = []
    for line in lines:
        name = re.match(r"[\w.-]+", line)
        extra = re.search(r"extra == ['\"]([\w-]+)['\"]", line)
        if name and not extra:
            required.append(name[0])
        elif name and extra and extra[1] not in DEVELOPMENT:
            optional.setdefault(extra[1], []).append(name[0])
    return required, optional


def find_version(name: str) -> str | None:
    """Return the version of an installed package; None if it is absent."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _lines(versions: Mapping[str, object]) -> Iterator[str]:
    """Yield a line for each fact; absent packages are named as such, with their extra."""
    yield f"python        {versions['python']}  ({versions['executable']})"
    yield f"platform      {versions['platform']}, {versions['processors']} processors"
    distro, rmw = versions["ros"], versions["rmw"] or "default middleware"
    yield f"ROS 2         {f'{distro}, {rmw}' if distro else 'not sourced'}"
    threads = _as_mapping(versions["threads"])
    yield f"threads       {', '.join(f'{k}={v}' for k, v in threads.items() if v) or 'not limited by the environment'}"
    packages = _as_mapping(versions["packages"])
    if not packages:
        yield "packages      unknown: ces_observer runs from its source folder and is not installed"
    yield from (f"{name:<13} {version or 'absent'}" for name, version in packages.items())
    told = set(packages)
    for extra, names in _as_mapping(versions["extras"]).items():
        for name, version in _as_mapping(names).items():
            if name not in told:
                yield f"{name:<13} {version or f'absent (optional: pip install ces_observer[{extra}])'}"
            told.add(name)


def _as_mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, Mapping) else {}
