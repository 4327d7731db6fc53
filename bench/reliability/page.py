"""The outcomes of a campaign as a table, one row a fault, and its place in docs/reliability.md."""

from __future__ import annotations

import sys
from math import isnan
from pathlib import Path

from faults import REAL
from judge import FaultOutcome
from memory import MAX_GROWTH_KB, Memory

from bench.markdown import replace_between

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE = ROOT / "docs" / "reliability.md"
HEADER = ("fault", "times", "told as", "worst recovery s", "worst force N", "worst error N", "verdict")


class CampaignRecord:
    """What is known of a campaign in `times` (real or simulated)."""

    def __init__(self, times: str, seed: int) -> None:
        self.times, self.seed = times, seed
        self.outcomes: dict[str, list[FaultOutcome]] = {}
        self.wrong: list[str] = []
        self._facts = ""

    def add(self, outcome: FaultOutcome) -> None:
        """Take an outcome, and say how it went."""
        self.outcomes.setdefault(outcome.fault, []).append(outcome)
        told = "; ".join(outcome.wrong) or "as it should"
        print(f"{outcome.fault:34} {outcome.recovery_s:6.3f} s  {told}", file=sys.stderr, flush=True)

    def end(self, seconds: float, estimates: int, memory: Memory) -> None:
        """Note length, number of estimates and memory."""
        growth = memory.growth_kB()
        told = "too short a run to tell its growth" if growth is None else f"{growth:+.0f} kB after the first minute"
        if growth is not None and growth > MAX_GROWTH_KB:
            self.wrong.append(f"memory grew by {growth:.0f} kB, allowed are {MAX_GROWTH_KB:.0f}")
        episodes = sum(map(len, self.outcomes.values()))
        self._facts = (
            f"{seconds / 60.0:.1f} minutes in {self.times} time, seed {self.seed}: {episodes} episodes, {estimates:,} "
            f"estimates; resident memory {memory.kB[-1] / 1024.0:.1f} MB, {told}"
        )

    def is_bad(self) -> bool:
        return bool(self.wrong) or any(one.wrong for several in self.outcomes.values() for one in several)

    def lines(self) -> list[str]:
        """Return the page's lines: facts, the table, and what went wrong besides."""
        rows = [_row(name, several) for name, several in sorted(self.outcomes.items())]
        head = [f"| {' | '.join(HEADER)} |", "|---|---:|---|---:|---:|---:|---|"]
        end = "The observer ended with status 0." if not self.wrong else f"**Wrong: {'; '.join(self.wrong)}.**"
        return [f"{self._facts}. {end}", "", *head, *rows]


def _row(name: str, outcomes: list[FaultOutcome]) -> str:
    reasons = sorted({one.reason for one in outcomes if one.reason})
    worst = [
        _worst([getattr(one, what) for one in outcomes]) for what in ("recovery_s", "worst_force_N", "worst_error_N")
    ]
    cells = [name, str(len(outcomes)), ", ".join(reasons) or "**not**"]
    cells += [f"{worst[0]:.3f}", f"{worst[1]:,.0f}", f"{worst[2]:,.0f}"]
    return f"| {' | '.join(cells)} | {_verdict(outcomes)} |"


def _worst(values: list[float]) -> float:
    return max((value for value in values if not isnan(value)), default=float("nan"))


def _verdict(outcomes: list[FaultOutcome]) -> str:
    bad = [one for one in outcomes if one.wrong]
    if not bad:
        return "passed"
    told = "; ".join(sorted({wrong for one in bad for wrong in one.wrong})[:3])
    return f"**failed {len(bad)} times**: {told}"


def write(record: CampaignRecord, memory: Memory) -> None:
    """Put the table between the comments that are meant for it, and the plot beside."""
    replace_between(PAGE, f"faults in {record.times} time", "\n".join(record.lines()))
    if record.times == REAL:
        memory.plot(ROOT / "docs" / "img" / "reliability_memory.png")
