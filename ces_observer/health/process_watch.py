"""The node's process: real-time options put in force, datagrams lost by the kernel; diagnostics out."""

from __future__ import annotations

from collections.abc import Callable

from ces_observer.health.kernel_drops import KernelDrops
from ces_observer.real_time import apply_options, describe_options


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

    def update(self) -> None:
        """Put the options in force, the first time, and count; call it in the executor, once a second."""
        if self._drops is None:
            self._drops = KernelDrops()
            problems = apply_options(*self._options)
            if problems:
                self._warn("real-time options that are not in force: " + "; ".join(problems))
        self._drops.update()
        self._values = (*describe_options(), ("datagrams dropped by the kernel", str(self._drops.total)))

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the key-value pairs for diagnostics."""
        return self._values

    def remark(self) -> str:
        """Return a remark on datagrams that were dropped before the last update, empty if there were none."""
        if self._drops is None or not self._drops.new:
            return ""
        return f"the kernel dropped {self._drops.new} datagrams in the last second: set net.core.rmem_max higher"
