"""This process: its load, and the datagrams that the kernel dropped because it did not read them in time."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from time import monotonic, process_time, thread_time
from typing import NamedTuple

PROCESS = Path("/proc/self")
SOCKET_TABLES = (PROCESS / "net/udp", PROCESS / "net/udp6")
MAX_SOCKETS = 10_000  # lines of a table that are read
INODE, DROPS = 9, 12  # columns


class Load(NamedTuple):
    """Recent load of the process and of the executor's thread, as shares of one core; None if unknown."""

    process: float | None = None
    executor: float | None = None


class ProcessWatch:
    """Watches the process from the first `update` on, when all threads of the executor and of DDS run."""

    def __init__(self) -> None:
        self._drops: KernelDrops | None = None
        self._times = monotonic(), process_time(), thread_time()

    def update(self) -> Load:
        """Count, and return the load since the last call. Call it in the executor each second."""
        self._drops = self._drops or KernelDrops()
        self._drops.update()
        now = monotonic(), process_time(), thread_time()
        elapsed, process, thread = (b - a for a, b in zip(self._times, now, strict=True))
        self._times = now
        return Load(process / elapsed, thread / elapsed) if elapsed > 0.0 else Load()

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the key-value pairs for diagnostics."""
        return (("datagrams dropped by the kernel", str(self._drops.total if self._drops else 0)),)

    def remark(self) -> str:
        """Return a remark on datagrams that were dropped before the last update, empty if there were none."""
        if self._drops is None or not self._drops.new:
            return ""
        return f"the kernel dropped {self._drops.new} datagrams in the last second: set net.core.rmem_max higher"


class KernelDrops:
    """Datagrams dropped at the UDP sockets that the process has when this is made: `total`, and `new` ones."""

    def __init__(self) -> None:
        self._inodes: set[str] = set()
        with suppress(OSError):  # not Linux
            for descriptor in (PROCESS / "fd").iterdir():
                with suppress(OSError):  # closed meanwhile
                    kind, _, inode = str(descriptor.readlink()).partition(":")
                    self._inodes |= {inode.strip("[]")} if kind == "socket" else set()
        self._start = self._count()
        self.total = self.new = 0

    def update(self) -> None:
        """Count again; `new` are those since the last call."""
        total = max(0, self._count() - self._start)
        self.new, self.total = max(0, total - self.total), total

    def _count(self) -> int:
        """Return the drops at these sockets since they were opened, as far as there are tables of sockets."""
        count = 0
        for table in SOCKET_TABLES if self._inodes else ():
            with suppress(OSError):
                rows = map(str.split, table.read_text(encoding="ascii").splitlines()[1:MAX_SOCKETS])
                own = (row for row in rows if len(row) > DROPS and row[INODE] in self._inodes)
                count += sum(int(row[DROPS]) for row in own if row[DROPS].isdecimal())
        return count
