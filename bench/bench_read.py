"""Time and peak memory of reading a bag: `read_recording` against a plain rosbags loop over the same messages.

A bag of position (JointState), current (Float64) and force (WrenchStamped), 1 kHz each, is written to a temporary
folder and read in both ways, each in a fresh process. `--minutes 60` is the full case.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
import warnings
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

from ces_data.bags.reader import RecordingWarning, read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_data.signals_file import load_signals

RATE = 1000
UNITS = {"position": "m", "current": "A", "force": "N"}


def make(path: Path, minutes: float) -> int:
    """Write the bag; return the number of its messages."""
    rng = np.random.default_rng(1)
    n = round(minutes * 60 * RATE)
    stamps = 1_000_000_000 + np.arange(n) * (1_000_000_000 // RATE)
    channels = {name: Channel(name, unit, stamps, rng.standard_normal(n)) for name, unit in UNITS.items()}
    write_bag(path, recording_topics(Recording("bench", channels), load_signals()))
    return 3 * n


def read_bulk(path: Path) -> dict[str, float]:
    """Return the sum of each signal's values, read as the programs do."""
    return {name: float(np.sum(c.values)) for name, c in read_recording(path, load_signals()).channels.items()}


def read_plain(path: Path) -> dict[str, float]:
    """Return the same, read with rosbags alone: one message at a time."""
    signals = load_signals().list_topic_signals()
    values: dict[str, list[float]] = {signal.name: [] for signal in signals}
    take = {"position": lambda m: m.position[0], "force": lambda m: m.wrench.force.z, "current": lambda m: m.data}
    with AnyReader([path]) as reader:
        names = {c.id: next(s.name for s in signals if s.matches(c.topic)) for c in reader.connections}
        for connection, _, raw in reader.messages():
            name = names[connection.id]
            values[name].append(take[name](reader.deserialize(raw, connection.msgtype)))
    return {name: float(np.sum(np.array(numbers))) for name, numbers in values.items()}


def measure(read: Callable[[Path], dict[str, float]], path: Path) -> tuple[float, float, dict[str, float]]:
    """Return seconds, peak memory [MB] and the sums."""
    warnings.simplefilter("ignore", RecordingWarning)
    start = time.perf_counter()
    sums = read(path)
    return time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, sums


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=3.0, help="length of the recording [min], default 3")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bench"
        count = make(bag, options.minutes)
        print(f"{options.minutes:g} min, {count / 1e6:.2f} million messages")
        results = []
        for read in (read_bulk, read_plain):
            with get_context("spawn").Pool(1) as fresh:
                seconds, peak_MB, sums = fresh.apply(measure, (read, bag))
            rate = count / seconds / 1e6
            print(f"{read.__name__:10} {seconds:8.2f} s {peak_MB:8.0f} MB peak {rate:8.3f} million messages/s")
            results.append((seconds, sums))
    (bulk_s, sums), (plain_s, others) = results
    assert sums == others, "bulk and plain differ"
    print(f"the same numbers, {plain_s / bulk_s:.1f} times as fast")


if __name__ == "__main__":
    main()
