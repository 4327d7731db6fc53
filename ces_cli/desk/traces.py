"""Recordings over time for a chart of any window: of ten million samples, the extremes in each pixel in milliseconds.

A process of its own reads a recording, with limits on its memory, files and time: a small file may unpack to any size.
It leaves arrays in a scratch folder, which `Traces`, the server's side, maps into memory.
"""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ces_data.bags.reader import read_recording
from ces_data.log_formats import is_log
from ces_data.mapping.proposals import propose_mapping
from ces_data.recording import Channel
from ces_data.signals_file import load_signals
from ces_observer.errors import CesError

BLOCK = 64  # samples whose extremes are kept: 10 million samples are 160,000 blocks, searched in 1 ms
MAX_RAW = 2  # samples of a pixel that are shown as they are
MAX_OPEN, FRESH_S = 4, 10.0  # recordings, and [s] for which one that changes is not read again
MAX_S, MAX_BYTES = 900, 16 << 30  # of reading [s], and of its memory and of each file
NAMES, ERRORS, SHARE = "names.json", "errors", "share"  # files that the reading process leaves
ARRAYS = ("time_s", "values", "blocks")
F = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class SignalTrace:
    """A signal: ascending `time_s` [s], `values`, and `blocks`, the least and the largest of each BLOCK; NaN: none."""

    name: str
    unit: str
    time_s: F  # (n,)
    values: F  # (n,)
    blocks: F  # (2, m)

    @classmethod
    def of(cls, channel: Channel, start_ns: int) -> Self:
        """Return the trace of a channel, its time counted from `start_ns`."""
        order = np.argsort(channel.stamps_ns, kind="stable")
        values = channel.values[order].astype(np.float32)
        values[~np.isfinite(values)] = np.nan
        places = np.arange(0, len(values), BLOCK)
        blocks = np.array([extreme.reduceat(values, places) for extreme in (np.fmin, np.fmax)])
        return cls(channel.name, channel.unit, 1e-9 * (channel.stamps_ns[order] - start_ns), values, blocks)

    def window(self, bounds: tuple[float, float], pixels: int) -> tuple[F, F]:
        """Return times and values in a window: two of each pixel where samples are denser than that."""
        first, last = map(int, np.searchsorted(self.time_s, bounds))
        first, last = max(0, first - 1), min(len(self.time_s), last + 1)  # a line goes on to the edges
        if last - first <= MAX_RAW * pixels:
            return self.time_s[first:last], self.values[first:last]
        step = BLOCK if last - first > MAX_RAW * pixels * BLOCK else 1
        first -= first % step
        edges = np.linspace(*bounds, pixels + 1)
        places = np.searchsorted(self.time_s[first:last:step], edges)
        starts, is_empty = np.minimum(places[:-1], places[-1] - 1), places[:-1] == places[1:]
        low, high = self.blocks[:, first // step : -(-last // step)] if step > 1 else [self.values[first:last]] * 2
        extremes = [np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)]
        return np.repeat(0.5 * (edges[1:] + edges[:-1]), 2), np.where(is_empty, np.nan, extremes).T.ravel()

    def draw(self, bounds: tuple[float, float], pixels: int) -> dict[str, Any]:
        """Return the window as JSON for a chart."""
        time_s, values = self.window(bounds, pixels)
        y = [None if np.isnan(value) else float(f"{value:.6g}") for value in values.tolist()]
        return {"name": self.name, "unit": self.unit, "x": np.round(time_s, 6).tolist(), "y": y}


class _Reader(subprocess.Popen[bytes]):
    """The process that reads a recording, or has read it, into a folder."""

    def __init__(self, path: Path, stamps: list[tuple[int, int]], signals: str) -> None:
        self.began, self.stamps, self.until = time.monotonic(), stamps, time.monotonic() + FRESH_S
        self._folder = tempfile.TemporaryDirectory(prefix="ces-serve-")
        self.folder = Path(self._folder.name)
        with (self.folder / ERRORS).open("wb") as errors:
            words = [sys.executable, "-P", "-m", __name__, str(path), str(self.folder), signals]
            super().__init__(words, stdin=subprocess.DEVNULL, stderr=errors)

    def describe(self, size_MB: float) -> str:
        """Return what is read, for how long, and how long the rest takes where that is known."""
        took = time.monotonic() - self.began
        with suppress(OSError, ValueError, ZeroDivisionError):
            share = float((self.folder / SHARE).read_text(encoding="utf-8"))
            rest = f"about {took * (1 - share) / share:.0f} s left" if share < 1.0 else "preparing the chart"
            return f"{size_MB:.0f} MB, {share:.0%} in {took:.0f} s, {rest}"
        return f"{size_MB:.1f} MB, {took:.0f} s so far"

    def load(self) -> list[SignalTrace]:
        """Return what the process has read, mapped; raises CesError if it has failed."""
        if self.returncode != 0:
            lines = (self.folder / ERRORS).read_text(encoding="utf-8", errors="replace").splitlines()
            raise CesError([f"ended after {MAX_S} s, or for want of memory (status {self.returncode})", *lines][-1])
        names = json.loads((self.folder / NAMES).read_text(encoding="utf-8"))
        files = ([self.folder / f"{k}_{part}.npy" for part in ARRAYS] for k in range(len(names)))
        return [SignalTrace(*n, *(np.load(f, mmap_mode="r") for f in fs)) for n, fs in zip(names, files, strict=True)]

    def drop(self) -> None:
        """End the process and remove its files; what is mapped stays until it is let go."""
        self.kill()
        self.wait()
        self._folder.cleanup()


class Traces:
    """Reads recordings and keeps the latest few; may be used by many threads."""

    def __init__(self, signals: str = "") -> None:
        self._signals, self._lock = signals, threading.Lock()
        self._readers: dict[Path, _Reader] = {}  # the latest used last

    def ask(self, path: Path, bounds: tuple[float, float] | None, pixels: int) -> dict[str, Any]:
        """Return the window of a recording (None: all of it) as JSON, or how far its reading is. Raises CesError."""
        files = [path, *sorted(path.iterdir())] if path.is_dir() else [path]
        stamps = [(status.st_mtime_ns, status.st_size) for status in (file.stat() for file in files)]
        with self._lock:
            reader = self._readers.pop(path, None)
            if reader and reader.stamps != stamps and reader.poll() is not None and time.monotonic() > reader.until:
                reader.drop()
                reader = None
            self._readers[path] = reader = reader or _Reader(path, stamps, self._signals)
            for old in list(self._readers)[:-MAX_OPEN]:
                self._readers.pop(old).drop()
        if reader.poll() is None:
            return {"reading": reader.describe(1e-6 * sum(size for _, size in stamps))}
        traces = reader.load()
        ends = [float(trace.time_s[end]) for trace in traces for end in (0, -1)]
        whole = (min(ends, default=0.0), max(ends, default=1.0))
        return {"whole": whole, "traces": [trace.draw(bounds or whole, pixels) for trace in traces]}


def main(path: str, out: str, signals: str) -> int:
    """Read a recording and write its arrays into `out`; returns 0, or 1 with the reason on standard error."""
    for kind in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (MAX_BYTES if hard == resource.RLIM_INFINITY else min(MAX_BYTES, hard), hard))
    signal.alarm(MAX_S)
    warnings.simplefilter("ignore")  # `ces info` says them

    def listen(share: float) -> None:
        (Path(out) / SHARE).write_text(f"{share}", encoding="utf-8")

    try:
        file, described = Path(path), load_signals(Path(signals) if signals else None)
        log = propose_mapping(file, need=(), progress=listen) if is_log(file) else None
        recording = log.read() if log else read_recording(file, described, ())
        channels = [channel for channel in recording.channels.values() if len(channel)]
        starts = {channel.name: int(channel.stamps_ns.min()) for channel in channels}
        start_ns = starts.get("position", min(starts.values(), default=0))  # as --part counts
        for number, channel in enumerate(channels):
            trace = SignalTrace.of(channel, start_ns)
            for part in ARRAYS:
                np.save(Path(out) / f"{number}_{part}.npy", getattr(trace, part))
        (Path(out) / NAMES).write_text(json.dumps([(c.name, c.unit) for c in channels]), encoding="utf-8")
    except (CesError, OSError, MemoryError) as error:
        print(str(error) or "not enough memory", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
