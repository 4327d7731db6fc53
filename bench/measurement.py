"""Common functions of the benchmarks: CPU and wall time, medians, versions, tables with their verdicts."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

PEERS = ("sysidentpy", "fastcan")


@dataclass(frozen=True)
class Spent:
    """CPU time [s], including children, and wall time [s]."""

    cpu: float
    wall: float


def time_call(work: Callable[[], T]) -> tuple[T, Spent]:
    """Return the result of `work` and its times."""
    cpu, wall = _cpu(), time.perf_counter()
    result = work()
    return result, Spent(_cpu() - cpu, time.perf_counter() - wall)


def _cpu() -> float:
    own, children = time.process_time(), os.times()  # os.times is coarse: used only for finished children
    return own + children.children_user + children.children_system


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Return the median CPU time of single-threaded `work` [s], after one run that is not counted.

    CPU time, since other programs may share the machine.
    """
    times = []
    for _ in range(repeats + 1):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return statistics.median(times[1:])


@cache
def is_installed(package: str) -> bool:
    """Return whether a peer is installed; print on standard error that it is skipped if not."""
    try:
        importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        print_note(f"{package} is not installed: skipped (pip install '.[bench]')")
        return False
    return True


def print_note(text: str) -> None:
    """Print on standard error: standard output contains only the table."""
    print(text, file=sys.stderr, flush=True)


def verdict(value: float, target: float, at_least: bool = False) -> str:
    """Return "met", or in bold by how much a target is missed."""
    short = target / value if at_least else value / target
    return "met" if short <= 1.0 else f"**missed by {100.0 * (short - 1.0):.0f} %**"


def machine() -> str:
    """Return a sentence with the processor, the number of cores in use, and the versions of packages."""
    versions = [f"Python {platform.python_version()}"]
    for package in ("numpy", "scipy", "numba", *PEERS):
        try:
            versions.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"no {package}")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{processor()}, {cores} cores (load {os.getloadavg()[0]:.1f} at the end); {', '.join(versions)}."


def processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
