"""`ces blind make|run|score`: tests the diagnosis on recordings with a withheld, sealed effect."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from ces_cli.blind import make as blind_make
from ces_cli.blind import run as blind_run
from ces_cli.blind import score as blind_score
from ces_cli.blind.mode import MAX_REFERENCES, RUN, SIMULATIONS
from ces_cli.terminal import terminal
from ces_cli.terminal.json_output import add_json

EXAMPLE = """\
ces blind make --out cases_1 --seed 1 --cases 100
  ces blind run cases_1 --out results_1 --simulation run predictions --references 0 2
  ces blind score cases_1 results_1 --out blind.md"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
    status: int = options.program(options)
    return status


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "blind",
        "Test the diagnosis on plants of the virtual rig with an effect that the simulation lacks: 'make' "
        "draws cases by seed and seals the answers, 'run' diagnoses from the recordings alone, 'score' opens the seal "
        "and compares.",
        EXAMPLE,
    )
    parts = p.add_subparsers(metavar="make|run|score", required=True)
    _add_make_options(parts.add_parser("make", help="draw cases, write their recordings and seal the answers"))
    _add_run_options(
        parts.add_parser("run", help="diagnose every case from its recordings; repeat to continue an interrupted run")
    )
    _add_score_options(parts.add_parser("score", help="open the seal and compare"))
    return p


def _add_make_options(p: argparse.ArgumentParser) -> None:
    number, whole = terminal.number_between, terminal.integer_between
    p.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write, new or empty")
    p.add_argument("--seed", type=whole(0, 2**31), required=True, metavar="N", help="random seed")
    p.add_argument("--grid", choices=("full", "small"), default="full", help="small: gap-to-noise 3 only")
    p.add_argument("--cases", type=whole(1, 100_000), metavar="K", help="draw a balanced sample of K cases")
    p.add_argument("--plants", nargs="+", metavar="KIND", help="kinds of plant (default: hydraulic bouc_wen)")
    p.add_argument("--kind", nargs="+", metavar="KIND", help="effect, none, outside, pair (default: all)")
    p.add_argument("--effects", nargs="+", metavar="NAME", help="library effects to draw from (default: all)")
    p.add_argument("--gap-to-noise", nargs="+", type=number(0.1, 100.0), metavar="X", help="gap-to-noise ratios")
    text = "length of a recording (default 10)"
    p.add_argument("--seconds", type=number(2.0, 600.0), default=10.0, metavar="S", help=text)
    _add_jobs(p)
    add_json(p)
    p.set_defaults(program=blind_make.make)


def _add_run_options(p: argparse.ArgumentParser) -> None:
    p.add_argument("cases", type=Path, metavar="DIR", help="output of 'make', or a copy with cases/ only")
    p.add_argument("--out", type=Path, required=True, metavar="RESULTS", help="folder for results")
    text = "what the diagnosis gets as simulation: one that it runs, recorded predictions, or a model identified from "
    text += "the references (default run); every combination with --references is diagnosed into a folder of its own"
    p.add_argument("--simulation", nargs="+", choices=SIMULATIONS, default=(RUN,), metavar="KIND", help=text)
    counts, text = range(MAX_REFERENCES + 1), "how many reference recordings it gets (default 2)"
    p.add_argument("--references", nargs="+", type=int, choices=counts, default=(2,), metavar="N", help=text)
    p.add_argument("--limit", type=terminal.integer_between(1, 100_000), metavar="K", help="only the first K cases")
    _add_jobs(p)
    add_json(p)
    p.set_defaults(program=blind_run.run)


def _add_score_options(p: argparse.ArgumentParser) -> None:
    p.add_argument("cases", type=Path, metavar="DIR", help="output of 'make'")
    text = "output of 'run', or the folder of one mode in it"
    p.add_argument("results", type=Path, nargs="+", metavar="RESULTS", help=text)
    p.add_argument("--out", type=Path, metavar="REPORT.md", help="also write the tables to this file")
    p.add_argument("--rows", type=Path, metavar="CASES.csv", help="also write one line for each case")
    add_json(p)
    p.set_defaults(program=blind_score.score)


def _add_jobs(p: argparse.ArgumentParser) -> None:
    whole, text = terminal.integer_between, "processes (default: all processors)"
    p.add_argument("--jobs", type=whole(1, 256), default=os.cpu_count() or 1, metavar="J", help=text)
