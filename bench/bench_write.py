"""The longest single calls while writing the black box's bag, message by message like the observer node.

Twenty seconds of a damper at 1 kHz (position, estimate, force; current at 200 Hz) are written to a temporary folder.
The processor time of each call is taken, so that other programs count for nothing; the node is held up for so long.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "test" / "support"))

from raw_messages import channels, drive

from ces_observer.recorder import mcap_file
from ces_observer.recorder.bag_folder import BagFolder

START_NS = 1_700_000_000 * 1_000_000_000
SECONDS = 20.0
CHUNKS_KIB = (16, 32, 64, 96, 128, 192)
REPEATS = 5  # the shortest is shown


def milliseconds(call: Callable[..., None], *arguments: object) -> float:
    begin = time.thread_time()
    call(*arguments)
    return 1e3 * (time.thread_time() - begin)


def write(path: Path, messages: list[tuple[int, int, bytes]]) -> tuple[float, float, float]:
    """Return the total time, the longest call (end of a chunk), and the end with the summary [ms]."""
    bag = BagFolder(path, channels(), {})
    writes = [milliseconds(bag.write, *message) for message in messages]
    return sum(writes), max(writes), milliseconds(bag.end)


def main() -> None:
    messages = drive(START_NS, SECONDS)
    print("| chunk [KiB] | all messages [ms] | longest write [ms] | end [ms] |")
    print("|------------:|------------------:|-------------------:|---------:|")
    for size in CHUNKS_KIB:
        mcap_file.CHUNK_BYTES = size << 10
        with tempfile.TemporaryDirectory() as folder:
            runs = [write(Path(folder) / str(i), messages) for i in range(REPEATS)]
        total, *others = map(min, zip(*runs, strict=True))
        print(f"| {size} | {total:.0f} | {' | '.join(f'{value:.2f}' for value in others)} |")


if __name__ == "__main__":
    main()
