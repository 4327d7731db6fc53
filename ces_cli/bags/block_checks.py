"""The checks of a recording that comes in blocks; one of a single block is checked as any other."""

from __future__ import annotations

import re
from dataclasses import replace

from ces_data.checks.check import check_recording
from ces_data.findings import SECOND, Finding, findings, sort_findings
from ces_data.recording import Recording

SHARE = 0.1  # of a block of a long log but the first, in which signs, units and delays are checked; faults in all of it
NUMBER = re.compile(r"[-+]?\d[\d.e+-]*")


class BlockChecks:
    """Takes the blocks of a recording; says how many samples of the position it has, and what is wrong."""

    def __init__(self) -> None:
        self.samples, self.blocks = 0, 0
        self._ends_ns: tuple[int, ...] = ()
        self._found: list[tuple[Finding, str]] = []
        self._last: Recording | None = None

    @property
    def rate_Hz(self) -> float:
        """The mean rate of the position samples, 0 if they have no span."""
        span = max(self._ends_ns) - min(self._ends_ns) if self._ends_ns else 0
        return (self.samples - 1) * SECOND / span if span else 0.0

    def add(self, block: Recording) -> None:
        """Take a block and check the one before; a short last one is checked together with it."""
        stamps = block.channel("position").stamps_ns
        if len(stamps):
            ends = (*self._ends_ns, int(stamps.min()), int(stamps.max()))
            self._ends_ns = min(ends), max(ends)
        self.samples += len(stamps)
        if self._last is not None and 2 * len(stamps) < len(self._last.channel("position")):
            self._last = Recording.join([self._last, block])
            return
        if self._last is not None:
            self._check(self._last)
        self._last = block

    def finish(self) -> tuple[Finding, ...]:
        """Return the findings, the worst first; of a long log each once, with the number of parts that show it."""
        if self._last is not None:
            self._check(self._last, last=True)
        if self.blocks == 1:
            return tuple(finding for finding, _ in self._found)
        same: dict[tuple[str, ...], list[tuple[Finding, str]]] = {}
        for one, when in self._found:
            same.setdefault((one.severity, one.signal, NUMBER.sub("", one.text)), []).append((one, when))
        merged = []
        for (finding, when), *more in same.values():
            parts = f"in {1 + len(more)} of {self.blocks} parts of the log"
            text = f"{finding.text} ({parts}; the numbers are of that {when}, with times from its start)"
            merged.append(replace(finding, text=text))
        return sort_findings(merged)

    def _check(self, block: Recording, last: bool = False) -> None:
        if self.blocks or not last:  # a slow channel may have no sample in it
            block = replace(block, channels={name: c for name, c in block.channels.items() if len(c)})
        found, first = list(findings(block)), self.blocks == 0
        if first or "position" in block.channels:
            found += check_recording(block if first else block.part(0.0, SHARE))
        stamps = [int(c.stamps_ns[at]) for c in block.channels.values() if len(c) for at in (0, -1)]
        ends = [(f(stamps, default=0) - min(self._ends_ns, default=0)) / SECOND for f in (min, max)]
        self._found += [(finding, f"from {ends[0]:.3f} s to {ends[1]:.3f} s") for finding in found]
        self.blocks += 1
