"""Measured dampers: free-run J [%] of our structures and of other tools, a row for each case.

    CES_DATA=FOLDER python -m bench.measured [--cases WORD...] [--tools WORD...] [--again] [--table] [--store FOLDER]

Each fit runs in a process of its own. Finished fits are kept in the store: a rerun continues, and `--again` repeats
those that are asked for. A case whose data are missing is skipped, and a tool that is not installed, unless its fit is
kept.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from pathlib import Path

from bench.markdown import markdown
from bench.measured.cases import CASES, ROOT
from bench.measured.jobs import FitJob, run_job, show_cost
from bench.measured.tools import OURS, TOOLS, is_available
from bench.measurement import print_note
from ces_identify.structures.auto import AUTO
from ces_observer.errors import RecordingError

STORE = ROOT / "out" / "measured"


def format_rows(costs: Mapping[str, Mapping[str, float]]) -> list[list[str]]:
    """Return the heading and a line for each case, the least J in bold; a cell without a fit is a dash."""
    tools = [tool for tool in TOOLS if any(tool in row for row in costs.values())]
    lines = [["case", *tools]]
    for case, row in costs.items():
        least = show_cost(min(row.values()))
        cells = [show_cost(row[tool]) if tool in row else "-" for tool in tools]
        lines.append([case, *(f"**{cell}**" if cell == least else cell for cell in cells)])
    return lines


def summarise(costs: Mapping[str, Mapping[str, float]]) -> str:
    """Return where a peer is better than `auto`, and the regret of `auto`, its J over the best of our structures."""
    lost, regrets = list[str](), dict[str, float]()
    for case, row in costs.items():
        if AUTO in row:
            regrets[case] = row[AUTO] / min(row[tool] for tool in OURS if tool in row)
            lost += [f"{case} ({tool})" for tool in TOOLS if tool not in OURS and row.get(tool, math.inf) < row[AUTO]]
    worst = max(regrets, key=lambda case: regrets[case], default="")
    regret = (
        f"Regret of `auto`, its J over the least of our structures: at most {regrets.get(worst, 1.0):.2f} ({worst})."
    )
    return f"{regret} Better than `auto`: {', '.join(lost) or 'none'}." if regrets else ""


def is_present(case: str) -> bool:
    """Return whether the files of a case are there; say so if not."""
    try:
        return bool(CASES[case]())
    except RecordingError as error:
        print_note(f"{case}: skipped: {error}")
        return False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", metavar="WORD", default=[""], help="cases whose name has one of these")
    parser.add_argument("--tools", nargs="+", metavar="WORD", default=[""], help="tools whose name has one of these")
    parser.add_argument("--store", type=Path, default=STORE, metavar="FOLDER", help="of finished fits")
    parser.add_argument("--again", action="store_true", help="repeat fits that are finished")
    parser.add_argument("--table", action="store_true", help="only show the finished fits")
    options = parser.parse_args()
    cases, tools = (
        [name for name in names if any(word in name for word in words)]
        for names, words in ((CASES, options.cases), (TOOLS, options.tools))
    )
    costs: dict[str, dict[str, float]] = {}
    for case in filter(is_present, cases):
        for tool in tools:
            job = FitJob(case, tool, options.store)
            if options.again and is_available(tool):
                job.path.unlink(missing_ok=True)
            if job.path.exists() or (not options.table and is_available(tool)):
                costs.setdefault(case, {})[tool] = run_job(job).cost
    print(f"{markdown(format_rows(costs))}\n\n{summarise(costs)}")


if __name__ == "__main__":
    main()
