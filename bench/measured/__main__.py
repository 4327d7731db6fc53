"""Measured dampers: free-run J [%] of our structures and of other tools, a row for each case.

    CES_DATA=FOLDER python -m bench.measured [--cases WORD...] [--tools WORD...] [--again] [--table] [--store FOLDER]

Each fit runs in a process of its own. Finished fits are kept in the store: a rerun continues, and `--again` repeats
those that are asked for. A case whose data are missing and a tool that is not installed are skipped.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.measured.cases import CASES, ROOT
from bench.measured.jobs import FitJob, run_job, show_cost
from bench.measured.tools import OURS, all_tools
from bench.measurement import print_note, print_table
from ces_identify.structures.auto import AUTO
from ces_observer.errors import RecordingError

STORE = ROOT / "out" / "measured"


def format_rows(costs: Mapping[str, Mapping[str, float]]) -> list[tuple[str, ...]]:
    """Return the heading and a line for each case, the least J in bold; a cell without a fit is a dash."""
    tools = list(dict.fromkeys(tool for row in costs.values() for tool in row))
    lines = [("case", *tools)]
    for case, row in costs.items():
        least = show_cost(min(row.values()))
        cells = [show_cost(row[tool]) if tool in row else "-" for tool in tools]
        lines.append((case, *(f"**{cell}**" if cell == least else cell for cell in cells)))
    return lines


def summarise(costs: Mapping[str, Mapping[str, float]]) -> str:
    """Return where a peer is better than `auto`, and the regret of `auto`, its J over the best of our structures."""
    lost, regrets = [], {}
    for case, row in costs.items():
        ours = {tool: cost for tool, cost in row.items() if tool in OURS}
        others = {tool: cost for tool, cost in row.items() if tool not in OURS}
        if AUTO not in ours:
            continue
        regrets[case] = ours[AUTO] / min(ours.values())
        lost += [f"{case} ({tool})" for tool, cost in others.items() if cost < ours[AUTO]]
    if not regrets:
        return ""
    worst = max(regrets, key=lambda case: regrets[case])
    regret = f"Regret of `auto`, its J over the least of our structures: at most {regrets[worst]:.2f} ({worst})."
    return f"{regret} Better than `auto`: {', '.join(lost) or 'none'}."


def present_cases(words: Sequence[str]) -> list[str]:
    """Return the cases whose name has one of the words and whose files are there, and say which are not."""
    found = []
    for name in (name for name in CASES if any(word in name for word in words)):
        try:
            CASES[name]()
        except RecordingError as error:
            print_note(f"{name}: skipped: {error}")
            continue
        found.append(name)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", metavar="WORD", default=[""], help="cases whose name has one of these")
    parser.add_argument("--tools", nargs="+", metavar="WORD", default=[""], help="tools whose name has one of these")
    parser.add_argument("--store", type=Path, default=STORE, metavar="FOLDER", help="of finished fits")
    parser.add_argument("--again", action="store_true", help="repeat fits that are finished")
    parser.add_argument("--table", action="store_true", help="only show the finished fits")
    options = parser.parse_args()
    tools = [name for name in all_tools() if any(word in name for word in options.tools)]
    jobs = [FitJob(case, tool, options.store) for case in present_cases(options.cases) for tool in tools]
    if options.again:
        for job in jobs:
            job.path.unlink(missing_ok=True)
    costs: dict[str, dict[str, float]] = {}
    for job in jobs:
        if not options.table or job.path.exists():
            outcome = run_job(job)
            costs.setdefault(job.case, {})[job.tool] = outcome.cost
    header, *rows = format_rows(costs)
    print_table(header, rows)
    print(f"\n{summarise(costs)}")


if __name__ == "__main__":
    main()
