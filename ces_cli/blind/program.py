"""`ces blind make|run|score`: diagnoses on recordings whose unmodelled effect is withheld and sealed."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from ces_cli.blind import make as blind_make
from ces_cli.blind import run as blind_run
from ces_cli.blind import score as blind_score
from ces_cli.terminal import terminal

EXAMPLE = """\
ces blind make --out cases_1 --seed 1 --cases 100
  ces blind run cases_1 --out results_1
  ces blind score cases_1 results_1 --out blind.md"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = _parser().parse_args(argv)
    status: int = options.program(options)
    return status


def _parser() -> terminal.Parser:
    p = terminal.parser(
        "blind",
        "Test the diagnosis on plants of the virtual rig with an effect that is withheld from the simulation: 'make' "
        "draws cases by seed and seals the answers, 'run' diagnoses from the recordings alone, 'score' opens the seal.",
        EXAMPLE,
    )
    parts = p.add_subparsers(metavar="make|run|score", required=True)
    _make_options(parts.add_parser("make", help="draw cases, write their recordings and seal the answers"))
    _run_options(parts.add_parser("run", help="diagnose every case from its recordings; a cut run resumes"))
    _score_options(parts.add_parser("score", help="open the seal and compare"))
    return p


def _make_options(p: argparse.ArgumentParser) -> None:
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write, new or empty")
    p.add_argument(
        "--seed", type=terminal.integer_between(0, 2**31), required=True, metavar="N", help="seed of all that is drawn"
    )
    p.add_argument("--grid", choices=("full", "small"), default="full", help="small: gap-to-noise 3 only")
    p.add_argument(
        "--cases", type=terminal.integer_between(1, 100_000), metavar="K", help="a balanced sample of the grid"
    )
    p.add_argument("--plants", nargs="+", metavar="KIND", help="kinds of plant (default: hydraulic bouc_wen)")
    p.add_argument("--kind", nargs="+", metavar="KIND", help="effect, none, outside, pair (default: all)")
    p.add_argument("--effects", nargs="+", metavar="NAME", help="library effects to draw from (default: all)")
    p.add_argument(
        "--gap-to-noise", nargs="+", type=terminal.number_between(0.1, 100.0), metavar="X", help="sizes of the effects"
    )
    p.add_argument(
        "--seconds", type=terminal.number_between(2.0, 600.0), default=10.0, metavar="S", help="of a recording (10)"
    )
    _jobs(p)
    p.set_defaults(program=blind_make.make)


def _run_options(p: argparse.ArgumentParser) -> None:
    p.add_argument("cases", type=Path, metavar="DIR", help="what 'make' wrote, or a copy with cases/ alone")
    p.add_argument("--out", type=Path, required=True, metavar="RESULTS", help="folder for results; a cut run resumes")
    p.add_argument("--predictions", action="store_true", help="the simulation is known by recorded predictions only")
    p.add_argument("--no-reference", action="store_true", help="leave the reference recordings out")
    p.add_argument("--limit", type=terminal.integer_between(1, 100_000), metavar="K", help="the first K cases only")
    _jobs(p)
    p.set_defaults(program=blind_run.run)


def _score_options(p: argparse.ArgumentParser) -> None:
    p.add_argument("cases", type=Path, metavar="DIR", help="what 'make' wrote")
    p.add_argument("results", type=Path, metavar="RESULTS", help="what 'run' wrote")
    p.add_argument("--out", type=Path, metavar="REPORT.md", help="write the tables to a file, too")
    p.add_argument("--rows", type=Path, metavar="CASES.csv", help="write a line for each case, too")
    p.set_defaults(program=blind_score.score)


def _jobs(p: argparse.ArgumentParser) -> None:
    most = os.cpu_count() or 1
    p.add_argument(
        "--jobs", type=terminal.integer_between(1, 256), default=most, metavar="J", help="processes (default: all)"
    )
