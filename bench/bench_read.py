"""Time and peak memory of reading a bag: `read_recording` against a plain rosbags loop over the same messages.

A bag of position (JointState), current (Float64) and force (WrenchStamped), 1 kHz each, is written to a temporary
folder and read by two fresh processes, which must come to the same numbers. `--minutes 60` is the full case.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
import warnings
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
    recording = read_recording(path, load_signals())
    return {name: checksum(c.stamps_ns, c.values) for name, c in recording.channels.items()}


def read_plain(path: Path) -> dict[str, float]:
    """Read with rosbags alone: one message at a time into lists."""
    signals = {signal.name: signal for signal in load_signals().list_topic_signals()}
    stamps: dict[str, list[int]] = {name: [] for name in signals}
    values: dict[str, list[float]] = {name: [] for name in signals}
    with AnyReader([path]) as reader:
        names = {c.id: next(s.name for s in signals.values() if s.matches(c.topic)) for c in reader.connections}
        for connection, log_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            name = names[connection.id]
            if name == "position":
                values[name].append(message.position[0])
            elif name == "force":
                values[name].append(message.wrench.force.z)
            else:
                values[name].append(message.data)
            stamp = getattr(getattr(message, "header", None), "stamp", None)
            stamps[name].append(stamp.sec * 1_000_000_000 + stamp.nanosec if stamp else log_ns)
    return {name: checksum(np.array(stamps[name]), np.array(values[name])) for name in signals}


def checksum(stamps: np.ndarray, values: np.ndarray) -> float:
    return float(np.sum(values) + np.sum(stamps % 1_000_003))


def worker(kind: str, path: Path) -> None:
    warnings.simplefilter("ignore", RecordingWarning)
    start = time.perf_counter()
    sums = KINDS[kind](path)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"seconds": seconds, "peak_MB": peak, "sums": sums}))


KINDS = {"bulk": read_bulk, "plain": read_plain}


def measure(kind: str, path: Path) -> dict:
    command = [sys.executable, __file__, "--worker", kind, "--bag", str(path)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=3.0, help="length of the recording [min], default 3")
    parser.add_argument("--worker", choices=tuple(KINDS), help=argparse.SUPPRESS)
    parser.add_argument("--bag", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        worker(options.worker, options.bag)
        return
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bench"
        count = make(bag, options.minutes)
        size = sum(file.stat().st_size for file in bag.iterdir()) / 1e6
        print(f"{options.minutes:g} min, {count / 1e6:.2f} million messages, {size:.0f} MB on disk")
        results = {kind: measure(kind, bag) for kind in KINDS}
    for kind, result in results.items():
        rate = count / result["seconds"] / 1e6
        print(f"{kind:7} {result['seconds']:8.2f} s {result['peak_MB']:8.0f} MB peak {rate:8.3f} million messages/s")
    if results["bulk"]["sums"] != results["plain"]["sums"]:
        sys.exit("bulk and plain differ")
    ratio = results["plain"]["seconds"] / results["bulk"]["seconds"]
    print(f"the same numbers, {ratio:.1f} times as fast")


if __name__ == "__main__":
    main()
