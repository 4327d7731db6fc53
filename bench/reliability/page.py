"""The outcomes of a campaign as a table, one row per fault, written into docs/reliability.md."""

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
HEADER = ("fault", "times", "reported as", "worst recovery s", "worst force N", "worst error N", "verdict")


class CampaignRecord:
    """The results of a campaign in `times` (real or simulated)."""

    def __init__(self, times: str, seed: int) -> None:
        self.times, self.seed = times, seed
        self.outcomes: dict[str, list[FaultOutcome]] = {}
        self.wrong: list[str] = []
        self._facts = ""

    def add(self, outcome: FaultOutcome) -> None:
        """Add an outcome and print it."""
        self.outcomes.setdefault(outcome.fault, []).append(outcome)
        result = "; ".join(outcome.wrong) or "passed"
        print(f"{outcome.fault:34} {outcome.recovery_s:6.3f} s  {result}", file=sys.stderr, flush=True)

    def end(self, seconds: float, estimates: int, memory: Memory) -> None:
        """Record length, number of estimates and memory."""
        growth = memory.growth_kB()
        change = "too short for its growth" if growth is None else f"{growth:+.0f} kB after the first minute"
        if growth is not None and growth > MAX_GROWTH_KB:
            self.wrong.append(f"memory grew by {growth:.0f} kB, at most {MAX_GROWTH_KB:.0f} allowed")
        episodes = sum(map(len, self.outcomes.values()))
        self._facts = (
            f"{seconds / 60.0:.1f} minutes in {self.times} time, seed {self.seed}: {episodes} episodes, {estimates:,} "
            f"estimates; resident memory {memory.kB[-1] / 1024.0:.1f} MB, {change}"
        )

    def is_bad(self) -> bool:
        return bool(self.wrong) or any(one.wrong for several in self.outcomes.values() for one in several)

    def lines(self) -> list[str]:
        """Return the page's lines: facts, further violations, and the table."""
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
    reasons = "; ".join(sorted({wrong for one in bad for wrong in one.wrong})[:3])
    return f"**failed {len(bad)} times**: {reasons}"


def write(record: CampaignRecord, memory: Memory) -> None:
    """Write the table between its comments in the page, and the plot beside it."""
    replace_between(PAGE, f"faults in {record.times} time", "\n".join(record.lines()))
    if record.times == REAL:
        memory.plot(ROOT / "docs" / "img" / "reliability_memory.png")
