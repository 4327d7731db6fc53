"""The black box: the last seconds of raw messages, kept in memory and written as a bag on request.

`save` starts a recording of the seconds before it and a few after it. `work` writes it in small steps, so that no
callback waits; only a thread waits for the disk. If the disk is full or the folder is not writable, nothing raises: the
recording is dropped and `problem` says why.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Thread

from ces_observer.recorder.bag_folder import BagFolder
from ces_observer.recorder.mcap_file import BagChannel
from ces_observer.recorder.record_folder import SECOND_NS, RecordFolder

OVERHEAD_BYTES = 250  # that Python needs for a message besides its bytes
MAX_DROPPED = 1500  # old messages dropped in one call of `work`
BATCH = 10  # messages written between two readings of the clock


class BlackBox:
    """Keeps the messages of `channels` over `seconds` + `tail_s`, and saves them as bags in `folder`.

    It keeps the newest messages up to `max_bytes`, including Python's overhead, and up to twice as much while it writes
    a recording. Bags are named LABEL_UTC; of each label the newest `max_bags` stay in the folder, as do all that hold
    more than a bag's own files. Recordings start at least `pause_s` apart. `saved` is the newest bag, `problem` why the
    last recording failed, empty if it did not.
    """

    def __init__(
        self,
        channels: Sequence[BagChannel],
        folder: Path,
        *,
        seconds: float = 15.0,
        tail_s: float = 5.0,
        max_bytes: int = 64 << 20,
        max_bags: int = 10,
        pause_s: float = 60.0,
    ) -> None:
        self._channels, self._folder = tuple(channels), RecordFolder(folder, max_bags)
        self._span_ns, self._tail_ns = round((seconds + tail_s) * SECOND_NS), round(tail_s * SECOND_NS)
        self._max_bytes, self._pause_ns = max_bytes, round(pause_s * SECOND_NS)
        self._saved_ns = -1 << 62
        self._due_ns: int | None = None
        self._label, self._notes = "", dict[str, str]()
        self._bag: BagFolder | None = None
        self._ender: Thread | None = None
        self._error: OSError | None = None
        self._writing: deque[tuple[int, int, bytes]] = deque()
        self._empty_ring()
        self.saved: Path | None = None
        self.problem = ""

    def add(self, channel: int, now_ns: int, raw: bytes) -> None:
        """Keep a message of the channel with this index, which arrived at `now_ns`."""
        self._ring.append((channel, now_ns, raw))
        self._bytes += len(raw) + OVERHEAD_BYTES
        if self._bytes > self._max_bytes:
            self._make_room()

    def save(self, label: str, now_ns: int, notes: Mapping[str, str]) -> bool:
        """Start a bag of the messages before `now_ns` and `tail_s` after it, with `notes` as its custom data.

        Returns False and does nothing while another bag is written or if the last was less than `pause_s` ago.
        """
        if self.busy or abs(now_ns - self._saved_ns) < self._pause_ns:
            return False
        self._label = re.sub(r"[^\w.-]+", "_", label).strip("_.") or "bag"
        self._notes = dict(notes)
        self._saved_ns, self._due_ns = now_ns, now_ns + self._tail_ns
        return True

    @property
    def busy(self) -> bool:
        """True from `save` until the bag is complete or dropped."""
        return self._due_ns is not None or self._bag is not None

    def work(self, budget_s: float, now_ns: int) -> None:
        """Drop old messages or continue a recording, for about `budget_s`; call it about ten times a second."""
        due = self._due_ns
        try:
            if due is not None and not due - self._tail_ns <= now_ns < due:
                self._begin()
            elif self._ender is not None:
                self._check_end()
            elif self._bag is not None and self._writing:
                self._write(self._bag, budget_s)
            elif self._bag is not None:
                self._end(self._bag)
            else:
                self._drop_old(now_ns)
        except OSError as error:
            self._drop_recording(error)

    def close(self) -> None:
        """Complete a started recording without waiting for its tail; for the end of the program."""
        try:
            if self._due_ns is not None:
                self._begin()
            if self._bag is not None and self._ender is None:
                self._write(self._bag, float("inf"))
                self._end(self._bag)
            if self._ender is not None:
                self._ender.join()
                self._check_end()
        except OSError as error:
            self._drop_recording(error)

    def _empty_ring(self) -> None:
        self._ring: deque[tuple[int, int, bytes]] = deque()
        self._bytes = 0

    def _make_room(self) -> None:
        """Drop the oldest messages, and a few more, so that the next `add` need not."""
        enough = self._max_bytes - self._max_bytes // 1024
        while self._bytes > enough:
            self._bytes -= len(self._ring.popleft()[2]) + OVERHEAD_BYTES

    def _drop_old(self, now_ns: int) -> None:
        """Drop a limited number of messages that are too old or from before the clock was set back."""
        ring, oldest = self._ring, now_ns - self._span_ns
        for _ in range(min(MAX_DROPPED, len(ring))):
            if oldest <= ring[0][1] <= now_ns:
                return
            self._bytes -= len(ring.popleft()[2]) + OVERHEAD_BYTES

    def _begin(self) -> None:
        """Move the kept messages to a new bag and continue with an empty ring."""
        self._due_ns = None
        self._writing, size = self._ring, self._bytes
        self._empty_ring()
        path = self._folder.new_bag(self._label, self._saved_ns, size)
        self._bag = BagFolder(path, self._channels, self._notes)

    def _write(self, bag: BagFolder, budget_s: float) -> None:
        end = time.perf_counter() + budget_s
        writing = self._writing
        while writing and time.perf_counter() < end:
            for _ in range(min(BATCH, len(writing))):
                bag.write(*writing.popleft())

    def _end(self, bag: BagFolder) -> None:
        bag.end()
        self._error = None
        self._ender = Thread(target=self._place, args=(bag,), name="black box", daemon=True)
        self._ender.start()

    def _place(self, bag: BagFolder) -> None:
        """Wait for the disk, in a thread of its own."""
        try:
            bag.place()
            self._folder.prune(self._label)
        except OSError as error:
            self._error = error

    def _check_end(self) -> None:
        """Set `saved` and `problem` once the thread has ended."""
        if self._ender is None or self._bag is None or self._ender.is_alive():
            return
        bag, error, self._ender = self._bag, self._error, None
        if error is not None and not bag.path.exists():
            raise error
        self.saved, self._bag, self.problem = bag.path, None, ""
        if error is not None:
            self.problem = f"{self._folder.path}: an older recording cannot be removed: {error.strerror or error}"

    def _drop_recording(self, error: OSError) -> None:
        self.problem = f"{self._folder.path}: a recording cannot be written: {error.strerror or error}"
        bag, self._bag, self._ender = self._bag, None, None
        self._writing.clear()
        if bag is not None:
            with suppress(OSError):
                bag.abandon()
