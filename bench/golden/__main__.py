"""Golden outputs: everything that the programs print and write, recorded from two versions and compared.

    git worktree add ../before 49c7113
    python -m bench.golden record --checkout ../before --out /tmp/golden/before
    python -m bench.golden record --out /tmp/golden/after
    python -m bench.golden compare /tmp/golden/before /tmp/golden/after

`record` runs the cases of cases.py with the code in --checkout (default: this tree; the inputs are always those of this
tree), each command in a process of its own in a temporary folder. It stores terminal text, exit status, tables, JSON,
YAML, C and pages; dates, versions, hashes and folders are masked, and clocks are slowed so that no time limit decides.
`compare` prints what differs; numbers may differ by --tolerance (relative). Exit status 1 if anything differs.
Goldens are not in the repository: they are large, and a change of wording is to be seen against the version before it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from bench.golden.cases import CASES
from bench.golden.compare import compare
from bench.golden.record import ROOT, record


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(dest="part", required=True)
    p = parts.add_parser("record")
    p.add_argument("--checkout", type=Path, default=ROOT)
    p.add_argument("--out", type=Path, required=True, help="new folder")
    p.add_argument("--only", nargs="+", choices=(*CASES, "serve"), default=[*CASES, "serve"], metavar="CASE")
    p.add_argument("--jobs", type=int, default=1)
    p = parts.add_parser("compare")
    p.add_argument("before", type=Path)
    p.add_argument("after", type=Path)
    p.add_argument("--tolerance", type=float, default=1e-9)
    p.add_argument("--lines", type=int, default=40, help="of a file that are shown (default 40)")
    options = parser.parse_args()
    if options.part == "compare":
        return int(compare(options.before, options.after, options.tolerance, options.lines))
    if options.out.exists() and any(options.out.iterdir()):
        parser.error(f"{options.out} is not empty")
    record(options.checkout, options.out, options.only, options.jobs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
