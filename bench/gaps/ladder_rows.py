"""The diagnoses of `smallest_gap.py` as rows of a file, and its tables from them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import isfinite, nan
from pathlib import Path
from statistics import median

from bench.markdown import markdown
from ces_gap.diagnosis import NO_GAP
from ces_rig.blind.draw import NOISE_N

GAPS_N = tuple(2.0 * 2.0 ** (0.5 * k) for k in range(14))  # [N] rungs of the ladder, a factor of 1.41 apart
POLYNOMIAL, AUTO, NONE = "polynomial", "auto", "none"
SIMULATIONS = (POLYNOMIAL, AUTO)


@dataclass(frozen=True)
class LadderRow:
    """One diagnosis: damper, simulation and its structure, effect, rung and true gap [N], and what the diagnosis says.

    `error_N` is the RMS of the simulation's error on the references, `corrected_N` what the learned correction leaves.
    """

    damper: str
    simulation: str
    structure: str
    effect: str
    rung: int
    gap_N: float
    verdict: str
    first: str
    error_N: float
    corrected_N: float

    @property
    def finds_gap(self) -> bool:
        return self.verdict != NO_GAP

    @property
    def finds_effect(self) -> bool:
        """Whether the most probable cause of a gap that it sees is the right one."""
        return self.finds_gap and self.first == self.effect


class RowFile:
    """Rows in a file of JSON lines, read once and appended to."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = path.read_text("utf-8").splitlines() if path.exists() else []
        self.rows = [LadderRow(**json.loads(line)) for line in lines]

    def of(self, damper: str, simulation: str, effect: str) -> list[LadderRow]:
        """Return the rows of one ladder."""
        key = (damper, simulation, effect)
        return [row for row in self.rows if (row.damper, row.simulation, row.effect) == key]

    def append(self, row: LadderRow) -> None:
        self.rows.append(row)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(row)) + "\n")


def smallest_N(rows: Sequence[LadderRow], passes: Callable[[LadderRow], bool]) -> float:
    """Return the smallest gap [N] of one ladder above which every tested gap passes.

    NaN if the largest fails, or if the rung below was not tested, as in an interrupted run.
    """
    rungs = {row.rung: row for row in rows}
    failed = max((rung for rung, row in rungs.items() if not passes(row)), default=-1)
    return rungs[failed + 1].gap_N if failed + 1 in rungs else nan


def tables(rows: Sequence[LadderRow]) -> str:
    """Return the Markdown tables: the smallest gaps of each ladder, their medians, and the errors of the models."""
    return "\n\n".join([_model_table(rows), _ladder_table(rows)])


def _model_table(rows: Sequence[LadderRow]) -> str:
    header = ("damper", "simulation", "its error on the references N", "left by the correction N", "false alarms")
    body = []
    for damper, simulation in sorted({(r.damper, r.simulation) for r in rows if r.effect == NONE}, reverse=True):
        same = [r for r in rows if (r.damper, r.simulation, r.effect) == (damper, simulation, NONE)]
        alarms = f"{sum(r.finds_gap for r in same)} of {len(same)}"
        named = f"{simulation} ({same[0].structure})"
        body.append((damper, named, f"{same[0].error_N:.1f}", f"{same[0].corrected_N:.1f}", alarms))
    return markdown([header, *body])


def _ladder_table(rows: Sequence[LadderRow]) -> str:
    """Return a row for each effect of each damper with both simulations, and the median ratios."""
    header = ["damper, effect"]
    for what in ("gap", "effect"):
        header += [f"{what} found from N: polynomial", AUTO, "ratio"]
    body: list[list[str]] = []
    ratios: list[list[float]] = [[], []]
    for damper, effect in sorted({(r.damper, r.effect) for r in rows if r.effect != NONE}):
        body.append([f"{damper}, {effect}"])
        for passes, found in zip((_finds_gap, _finds_effect), ratios, strict=True):
            pair = _smallest_pair([r for r in rows if (r.damper, r.effect) == (damper, effect)], passes)
            share = pair[1] / pair[0]
            found.extend([share] if isfinite(share) else [])
            body[-1] += [*map(_format_gap, pair), f"{share:.2f}" if isfinite(share) else ""]
    medians = [f"{median(r):.2f} ({len(r)})" if r else "" for r in ratios]
    return markdown([header, *body, ["median ratio (of pairs)", "", "", medians[0], "", "", medians[1]]])


def _smallest_pair(rows: Sequence[LadderRow], passes: Callable[[LadderRow], bool]) -> tuple[float, float]:
    """Return the smallest gap [N] with the polynomial and with the best structure, NaN where none was found."""
    one, other = (smallest_N([r for r in rows if r.simulation == s], passes) for s in SIMULATIONS)
    return one, other


def _finds_gap(row: LadderRow) -> bool:
    return row.finds_gap


def _finds_effect(row: LadderRow) -> bool:
    return row.finds_effect


def _format_gap(gap_N: float) -> str:
    return f"{gap_N:.1f} ({gap_N / NOISE_N:.1f}×)" if isfinite(gap_N) else "not found"
