"""Datagrams that the kernel dropped because this process did not read them in time, from the tables in /proc/net.

A full receive buffer loses messages before DDS sees them. With shared memory instead of UDP nothing is counted.
"""

from __future__ import annotations

from pathlib import Path

TABLES = (Path("/proc/self/net/udp"), Path("/proc/self/net/udp6"))
DESCRIPTORS = Path("/proc/self/fd")
MAX_SOCKETS = 10_000  # lines of a table that are read
INODE, DROPS = 9, 12  # columns


class KernelDrops:
    """Datagrams dropped at the UDP sockets that the process has when this is made: `total`, and `new` ones."""

    def __init__(self) -> None:
        self._inodes = _own_sockets()
        self._start = self._count()
        self.total = self.new = 0

    def update(self) -> None:
        """Count again; `new` are those since the last call."""
        total = max(0, self._count() - self._start)
        self.new, self.total = max(0, total - self.total), total

    def _count(self) -> int:
        return sum(_read_drops(table, self._inodes) for table in TABLES)


def _own_sockets() -> frozenset[str]:
    """Return the inodes of this process' sockets."""
    try:
        targets = [_read_link(entry) for entry in DESCRIPTORS.iterdir()]
    except OSError:  # not Linux
        return frozenset()
    return frozenset(target.removeprefix("socket:[")[:-1] for target in targets if target.startswith("socket:["))


def _read_link(path: Path) -> str:
    try:
        return str(path.readlink())
    except OSError:  # closed meanwhile
        return ""


def _read_drops(table: Path, inodes: frozenset[str]) -> int:
    """Return the drops of the sockets with these inodes; 0 if there is no such table."""
    if not inodes:
        return 0
    try:
        lines = table.read_text(encoding="ascii").splitlines()[1:MAX_SOCKETS]
    except OSError:
        return 0
    columns = [line.split() for line in lines]
    return sum(
        int(row[DROPS]) for row in columns if len(row) > DROPS and row[INODE] in inodes and row[DROPS].isdecimal()
    )
