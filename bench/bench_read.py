"""Time and peak memory of reading a bag: `read_recording` against a plain rosbags loop over the same messages.

Beside them, the splitting of the file into raw messages alone: the compiled scan against the mcap library's own loop.

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
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from ces_identify.recordings.bag_reader import RecordingWarning, read_recording
from ces_identify.recordings.bag_writer import recording_topics, write_bag
from ces_identify.recordings.mcap_records import blocks
from ces_identify.recordings.recording import Channel, Recording
from ces_identify.recordings.signals_file import load_signals

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


def split_by_scan(path: Path) -> dict[str, float]:
    found = [(len(block), int(block.lengths.sum())) for file in path.glob("*.mcap") for block in blocks(file)]
    return dict(zip(("messages", "bytes"), map(sum, zip(*found, strict=True)), strict=True))


def split_by_library(path: Path) -> dict[str, float]:
    lengths = []
    for bag in path.glob("*.mcap"):
        with bag.open("rb") as file:
            messages = make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
            lengths += [len(message.data) for _, _, message in messages]
    return {"messages": len(lengths), "bytes": sum(lengths)}


def checksum(stamps: np.ndarray, values: np.ndarray) -> float:
    return float(np.sum(values) + np.sum(stamps % 1_000_003))


def worker(kind: str, path: Path) -> None:
    warnings.simplefilter("ignore", RecordingWarning)
    start = time.perf_counter()
    sums = KINDS[kind](path)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"seconds": seconds, "peak_MB": peak, "sums": sums}))


KINDS = {"bulk": read_bulk, "plain": read_plain, "scan": split_by_scan, "library": split_by_library}


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
    for one, other in (("bulk", "plain"), ("scan", "library")):
        if results[one]["sums"] != results[other]["sums"]:
            sys.exit(f"{one} and {other} differ")
    ratio = results["plain"]["seconds"] / results["bulk"]["seconds"]
    print(f"the same numbers, {ratio:.1f} times as fast")


if __name__ == "__main__":
    main()
