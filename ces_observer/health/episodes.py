"""Episodes of withholding: from a withheld force to the next published one, with reasons and counts."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

MAX_EPISODES = 10  # ended episodes listed one by one; the totals count all
MAX_REASONS = 4  # of one episode listed by name


@dataclass(frozen=True)
class Episode:
    """An ended episode: its start [ns of the node's clock], length [s], reasons in order, and withheld samples."""

    start_ns: int
    length_s: float
    reasons: tuple[str, ...]
    withheld: int

    @property
    def reason(self) -> str:
        """All its reasons in one line."""
        return ", then ".join(self.reasons)

    def __str__(self) -> str:
        start = f"{self.start_ns // 10**9}.{self.start_ns // 10**6 % 1000:03d} s"
        return f"{start}, for {self.length_s:.3f} s: {self.reason} ({self.withheld} samples withheld)"


class Episodes:
    """Episodes of one damper: `total` counts the ended ones, `last` holds the newest of them.

    `by_reason` maps the first reason to number and total length [s] of its episodes.
    """

    def __init__(self) -> None:
        self.total = 0
        self.last: deque[Episode] = deque(maxlen=MAX_EPISODES)
        self.by_reason: dict[str, tuple[int, float]] = {}
        self._reasons: list[str] = []
        self._start_ns = self._withheld = 0

    def add_withheld(self, reason: str, now_ns: int, withheld_before: int) -> None:
        """Add a reason for withholding; `withheld_before` counts the samples withheld before this one."""
        if not self._reasons:
            self._start_ns, self._withheld = now_ns, withheld_before
        if reason not in self._reasons and len(self._reasons) < MAX_REASONS:
            self._reasons.append(reason)

    def end_episode(self, now_ns: int, withheld: int) -> None:
        """End the episode, if there is one; `withheld` counts the samples withheld so far.

        One that began at 0, before the first /clock of simulated time, is taken to begin now.
        """
        if not self._reasons:
            return
        start_ns = self._start_ns or now_ns
        length_s = max(0, now_ns - start_ns) * 1e-9
        episode = Episode(start_ns, length_s, tuple(self._reasons), withheld - self._withheld)
        self._reasons.clear()
        self.total += 1
        self.last.append(episode)
        count, length = self.by_reason.get(episode.reasons[0], (0, 0.0))
        self.by_reason[episode.reasons[0]] = count + 1, length + episode.length_s
