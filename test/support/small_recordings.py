"""Small recordings of a simple damper, as channels, bags and CSV files, on which a search takes a second."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_observer.signals import Signals

RULES = """\
force: {lags: [1]}
speed: {lags: [0, 2], powers: [0.5, 1.0], forms: [signed, magnitude]}
current: {lags: [0], powers: [1.0], forms: [magnitude]}
products: [[], [speed], [speed, current], [force]]
"""
UNITS = {"position": "m", "current": "A", "force": "N"}


def make_columns(
    seconds: float = 12.0, seed: int = 1, rate: float = 500.0
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Return times [s] (n,), and position [m], current [A] and force [N], each (n,)."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    x = 0.01 * np.sin(2 * np.pi * 3 * t) + 0.004 * np.sin(2 * np.pi * 7.3 * t + seed)
    v = np.gradient(x, t)
    i = 0.5 + 0.15 * np.sin(2 * np.pi * 0.7 * t)
    force = np.sign(v) * np.abs(v) ** 0.5 * (400 + 1500 * i) + 100 * v + random.normal(0, 3, len(t))
    return t, {"position": x, "current": i, "force": force}


def columns_as_channels(t: NDArray[np.float64], columns: dict[str, NDArray[np.float64]]) -> dict[str, Channel]:
    """Return the channels of columns that were sampled at times `t` [s]."""
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    return {name: Channel(name, UNITS[name], stamps, values) for name, values in columns.items()}


def write_channels(path: Path, channels: dict[str, Channel]) -> Path:
    """Write a bag with the default topics, and return its path."""
    write_bag(path, recording_topics(Recording(path.name, channels), Signals.from_mapping({}, "defaults")))
    return path


def write_columns(path: Path, t: NDArray[np.float64], columns: dict[str, NDArray[np.float64]]) -> Path:
    """Write a bag of columns that were sampled at times `t` [s], and return its path."""
    return write_channels(path, columns_as_channels(t, columns))


def write_small_csv(path: Path, seed: int = 1, seconds: float = 12.0, in_mm: bool = False) -> Path:
    """Write a CSV file with a header, and return its path; with `in_mm` the position is in millimetres."""
    t, columns = make_columns(seconds, seed)
    position = columns["position"] * (1e3 if in_mm else 1.0)
    names = ("time_s", "position_mm" if in_mm else "position_m", "current_A", "force_N")
    table = np.column_stack((t, position, columns["current"], columns["force"]))
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(names), comments="")
    return path
