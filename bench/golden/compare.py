"""Compares two folders of goldens, line by line; numbers may differ by a tolerance, nothing else may."""

from __future__ import annotations

import re
from collections import Counter
from difflib import SequenceMatcher, unified_diff
from math import isclose
from pathlib import Path

NUMBER = re.compile(r"(?<![\w.])[-−+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def compare(before: Path, after: Path, relative: float, shown: int) -> bool:
    """Print how two folders differ, at most `shown` lines of each file; return whether they do."""
    names = sorted({str(p.relative_to(folder)) for folder in (before, after) for p in folder.rglob("*") if p.is_file()})
    states: Counter[str] = Counter()
    same: Counter[str] = Counter()
    for name in names:
        state, lines = _compare_files(before / name, after / name, relative)
        states[state] += 1
        same[name.split("/")[0]] += state == "same"
        if state != "same":
            print(
                "\n".join(
                    [f"{state}: {name}", *lines[:shown], *([f"... {len(lines) - shown} more"] * (len(lines) > shown))]
                )
            )
    print(*(f"same: {case}: {count} files" for case, count in same.items()), sep="\n")
    print(", ".join(f"{count} {state}" for state, count in states.items()) + f" (numbers within {relative:g} relative)")
    return set(states) != {"same"}


def _compare_files(before: Path, after: Path, relative: float) -> tuple[str, list[str]]:
    if not before.exists() or not after.exists():
        return ("new" if after.exists() else "missing"), []
    old, new = (path.read_text(encoding="utf-8").splitlines() for path in (before, after))
    if old != new:
        new = _take_close_lines(old, new, relative)
    lines = list(unified_diff(old, new, "before", "after", lineterm="", n=1))[2:] if old != new else []
    return ("different" if lines else "same"), [line[:300] for line in lines]


def _take_close_lines(old: list[str], new: list[str], relative: float) -> list[str]:
    """Return `new` with the lines of `old` where only digits beyond the tolerance differ."""
    taken = list(new)
    for kind, b, b_end, a, a_end in SequenceMatcher(None, old, new).get_opcodes():
        if kind == "replace" and b_end - b == a_end - a:
            for k in range(b_end - b):
                taken[a + k] = old[b + k] if _is_close(old[b + k], new[a + k], relative) else new[a + k]
    return taken


def _is_close(old: str, new: str, relative: float) -> bool:
    if NUMBER.sub("#", old) != NUMBER.sub("#", new):
        return False
    pairs = zip(NUMBER.findall(old), NUMBER.findall(new), strict=True)
    return all(isclose(float(o.replace("−", "-")), float(n.replace("−", "-")), rel_tol=relative) for o, n in pairs)
