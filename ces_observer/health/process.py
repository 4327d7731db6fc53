"""This process: its load, its real-time options (SCHED_FIFO, processors, locked memory), and datagrams it has lost.

All threads of the process are set, those of DDS with it: its receiving thread must read a datagram before the kernel's
buffer is full, so it gets the next higher priority. Threads and processes that start later are ordinary ones. What is
not permitted is a warning. Only the standard library is used; the options exist on Linux.
"""

from __future__ import annotations

import ctypes
import os
import resource
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from time import monotonic, process_time, thread_time
from typing import NamedTuple

from ces_observer.errors import CesError

MAX_PRIORITY = 98  # of the executor; the threads of DDS have one more
LOCK_CURRENT, LOCK_FUTURE, LOCK_ON_FAULT = 1, 2, 4  # of mlockall(2); pages are locked when they are first used
CAP_IPC_LOCK = 1 << 14  # of capabilities(7)
MAX_PROCESSORS = 4096
ALL_PROCESSORS = [-1]  # ROS 2 has no empty list
PROCESS = Path("/proc/self")
SOCKET_TABLES = (PROCESS / "net/udp", PROCESS / "net/udp6")
MAX_SOCKETS = 10_000  # lines of a table that are read
INODE, DROPS = 9, 12  # columns
_HOW_PRIORITY = "allow it with 'rtprio' in /etc/security/limits.conf, LimitRTPRIO= of systemd, or CAP_SYS_NICE"
_HOW_LOCK = "set 'memlock unlimited' in /etc/security/limits.conf, LimitMEMLOCK=infinity of systemd, or CAP_IPC_LOCK"


class Load(NamedTuple):
    """Recent load of the process and of the executor's thread, as shares of one core; None if unknown."""

    process: float | None = None
    executor: float | None = None


class ProcessWatch:
    """Watches the process from the first `update` on, when all threads of the executor and of DDS run.

    `priority` is that of SCHED_FIFO, 0 for none; `processors` are those to run on, none for all. `warn` is called with
    one line if an option cannot be put in force.
    """

    def __init__(
        self, priority: int, processors: frozenset[int], lock_memory: bool, warn: Callable[[str], None]
    ) -> None:
        self._options = priority, processors, lock_memory
        self._warn = warn
        self._drops: KernelDrops | None = None
        self._values: tuple[tuple[str, str], ...] = ()
        self._times = monotonic(), process_time(), thread_time()

    def update(self) -> Load:
        """Put the options in force, the first time, and count; return the load. Call it in the executor each second."""
        if self._drops is None:
            self._drops = KernelDrops()
            problems = apply_options(*self._options)
            if problems:
                self._warn("real-time options that are not in force: " + "; ".join(problems))
        self._drops.update()
        self._values = (*describe_options(), ("datagrams dropped by the kernel", str(self._drops.total)))
        now = monotonic(), process_time(), thread_time()
        elapsed, process, thread = (b - a for a, b in zip(self._times, now, strict=True))
        self._times = now
        return Load(process / elapsed, thread / elapsed) if elapsed > 0.0 else Load()

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the key-value pairs for diagnostics."""
        return self._values

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


def check_processors(numbers: Sequence[int]) -> frozenset[int]:
    """Return the processors with these numbers, none for ALL_PROCESSORS; raises CesError if there are no such ones."""
    if list(numbers) == ALL_PROCESSORS:
        return frozenset()
    if not numbers or not all(0 <= number < MAX_PROCESSORS for number in numbers):
        raise CesError(f"parameter 'cpu_affinity' is {list(numbers)}; expected numbers of processors such as [2, 3]")
    return frozenset(numbers)


def apply_options(priority: int, processors: frozenset[int], lock_memory: bool) -> list[str]:
    """Put the options in force, as far as possible; return why those that are not, are not. Call it in the executor."""
    return [
        *(_set_priority(priority) if priority else ()),
        *(_set_processors(processors) if processors else ()),
        *(_lock_memory() if lock_memory else ()),
    ]


def describe_options() -> tuple[tuple[str, str], ...]:
    """Return what is in force, as key-value pairs for diagnostics; call it in the executor. Empty if unknown."""
    try:
        policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        priority = os.sched_getparam(0).sched_priority
        names = {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR"}
        scheduling = names.get(policy, str(policy)) + (f", priority {priority}" if priority else "")
        processors = ",".join(map(str, sorted(os.sched_getaffinity(0))))
        locked = "yes" if int(_read_status("VmLck").split()[0]) else "no"
    except (AttributeError, OSError, ValueError, IndexError):
        return ()
    return ("scheduling", scheduling), ("processors", processors), ("memory locked", locked)


def _set_priority(priority: int) -> Iterator[str]:
    """Set SCHED_FIFO for all threads; processes that they start have the ordinary policy again."""
    own = threading.get_native_id()
    try:
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        for thread in _threads():
            os.sched_setscheduler(thread, policy, os.sched_param(priority + (thread != own)))
    except PermissionError:
        yield f"realtime_priority {priority} is not permitted: {_HOW_PRIORITY}"
    except (AttributeError, OSError) as error:
        yield f"realtime_priority {priority} is not possible: {error}"


def _set_processors(processors: frozenset[int]) -> Iterator[str]:
    text = ",".join(map(str, sorted(processors)))
    try:
        for thread in _threads():
            os.sched_setaffinity(thread, processors)
    except (AttributeError, OSError, ValueError) as error:
        yield f"cpu_affinity {text} is not possible: {error}; the computer has {os.cpu_count()} processors"


def _lock_memory() -> Iterator[str]:
    """Lock all memory, unless a limit would make later allocations fail."""
    try:
        unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
        if not unlimited and not int(_read_status("CapEff"), 16) & CAP_IPC_LOCK:
            yield f"lock_memory is not permitted: {_HOW_LOCK}"
            return
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(LOCK_CURRENT | LOCK_FUTURE | LOCK_ON_FAULT):
            yield f"lock_memory is not possible: {os.strerror(ctypes.get_errno())}"
    except (AttributeError, OSError, ValueError) as error:
        yield f"lock_memory is not possible: {error}"


def _threads() -> list[int]:
    return [int(entry.name) for entry in (PROCESS / "task").iterdir()]


def _read_status(name: str) -> str:
    """Return a field of this process' status; raises ValueError if it is not there."""
    for line in (PROCESS / "status").read_text(encoding="utf-8").splitlines():
        key, _, value = line.partition(":")
        if key == name:
            return value.strip()
    raise ValueError(f"{PROCESS}/status has no {name}")
