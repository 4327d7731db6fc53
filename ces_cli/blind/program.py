"""`ces blind make|run|score`: tests the diagnosis on recordings with a withheld, sealed effect."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from statistics import median
from typing import Any

from rich.progress import track

from ces_cli.blind.diagnosing import run
from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import find_bag
from ces_cli.terminal.options import JOBS, JSON, OVERWRITE, SIGNALS, Argument, only_with
from ces_cli.terminal.outputs import print_document, require_outputs
from ces_cli.terminal.progress import JobsProgress
from ces_observer.errors import CesError
from ces_observer.json_text import write_atomically
from ces_observer.options import Option
from ces_rig.blind.cases import make_cases, open_seal, remove_cases
from ces_rig.blind.metrics import ScoreTable, group_cases, metric_table, mode_facts, withheld_table
from ces_rig.blind.plan import ERRORS, GAPS, KINDS, Levels, list_spare_effects, plan_sample
from ces_rig.blind.scoring import MAX_REFERENCES, RUN, SIMULATIONS, CaseOutcome, find_modes, score_cases
from ces_rig.dampers.effects import EFFECTS, OUTSIDE
from ces_rig.dampers.lookup.parameters import learn_lookup
from ces_rig.dampers.model import DamperModel
from ces_rig.dampers.stepper import KINDS as DAMPERS

DEFAULT_PLANTS = ("lookup", "bouc_wen")  # their equations are not those of the diagnosis' twin
MAP = "map"  # the plant that --recording teaches
SLICES = {"gap-to-noise": "gap_to_noise", "simulation's error / gap": "baseline_ratio", "plant": "plant"}
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
        rules=(only_with("signals", "recording", "applies to --recording only; add it"),),
    )
    parts = p.add_subparsers(metavar="make|run|score", required=True)
    for (name, (about, program, options)), example in zip(_PARTS.items(), EXAMPLE.splitlines(), strict=True):
        texts: dict[str, Any] = {"description": f"{about.capitalize()}.", "epilog": f"example:\n  {example.strip()}"}
        part = parts.add_parser(name, help=about, **texts, formatter_class=argparse.RawDescriptionHelpFormatter)
        terminal.add_options(part, *options)
        part.set_defaults(program=program)
    return p


def _make(options: argparse.Namespace) -> int:
    plants: dict[str, DamperModel] = {name: DAMPERS[name].design for name in options.plants or DEFAULT_PLANTS}
    if options.recording is not None:
        signals = terminal.load_described_signals(options)
        plants[MAP] = learn_lookup(terminal.read_one(find_bag(options.recording), signals, terminal.FORCE))
    levels = Levels(
        effects=tuple(dict.fromkeys(options.effects or EFFECTS)),
        outside=OUTSIDE,
        plants=plants,
        kinds=tuple(dict.fromkeys(options.kind or KINDS)),
        gaps=tuple(options.gap_to_noise or GAPS),
        errors=tuple(options.simulation_error or ERRORS),
    )
    require_outputs(options.overwrite, folders={"--out": options.out})
    plan = plan_sample(levels, options.seed, options.cases)
    if options.overwrite:
        remove_cases(options.out)
    with JobsProgress(len(plan), 0, "cases") as progress:
        digest = make_cases(
            options.out,
            [(case, list_spare_effects(case, levels)) for case in plan],
            options.seconds,
            options.jobs or os.cpu_count() or 1,
            {"seed": options.seed, "planned": len(plan), "plants": list(levels.plants)},
            lambda label: progress.count(f"case {label['case']} created"),
        )
    count_of = {kind: sum(case.kind == kind for case in plan) for kind in KINDS}
    if options.json:
        print_document("blind-make", {"folder": options.out, "cases": count_of, "sha256": digest})
    else:
        counts = ", ".join(f"{number} {kind}" for kind, number in count_of.items())
        print(f"{options.out}/cases: {counts}; answers sealed, SHA-256 {digest}")
    return 0


def _score(options: argparse.Namespace) -> int:
    """Score results against the seal, print the tables and write them; returns the exit status. Raises CesError."""
    require_outputs(options.overwrite, {"--out": options.out})
    about, labels = open_seal(options.cases)
    by_mode: dict[str, list[CaseOutcome]] = {}
    parts: list[str | ScoreTable] = []
    for folder, mode in find_modes(options.results, options.cases):
        if mode.name in by_mode:
            raise CesError(f"{folder}: a second folder with results of mode {mode.name}; give one for each mode")
        shown = track(labels, "scoring", console=terminal.err, transient=True, disable=not terminal.err.is_terminal)
        outcomes, failed = score_cases(options.cases, folder, shown, mode)
        if outcomes:
            by_mode[mode.name] = outcomes
            parts += [f"## `{mode.name}`", _format_opening(outcomes, failed, len(labels), about)]
            groups = {title: group_cases(outcomes, attrgetter(key)) for title, key in SLICES.items()}
            parts += [*(metric_table(*group) for group in groups.items()), withheld_table(outcomes)]
    if not by_mode:
        raise CesError(
            f"{options.results[0]}: contains no diagnosis of a case of {options.cases}; run 'ces blind run' first"
        )
    parts = [metric_table("mode", by_mode), *parts]
    text = "\n\n".join(_as_markdown(part) if isinstance(part, ScoreTable) else part for part in parts)
    if options.json:
        print_document("blind-score", {"modes": {name: mode_facts(cases) for name, cases in by_mode.items()}})
    else:
        print(text)
    if options.out is not None:
        write_atomically(options.out, text + "\n")
    return 0


def _format_opening(
    cases: Sequence[CaseOutcome], failed: Mapping[str, str], sealed: int, about: Mapping[str, Any]
) -> str:
    seconds = median(case.seconds for case in cases)
    first = (
        f"Seed {about['seed']}: {len(cases)} of {sealed} sealed cases, {about['seconds']:g} s per recording, "
        f"{seconds:.1f} s per case (median, one thread)."
    )
    return "  \n".join([first, *(f"Case {case} could not be diagnosed: {why}" for case, why in failed.items())])


def _as_markdown(table: ScoreTable) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in (table.head, *table.rows)]
    return "\n".join([lines[0], "|" + "---|" * len(table.head), *lines[1:]])


def _several(name: str, default: Any, meaning: str, metavar: str = "KIND", **how: Any) -> Option:
    return Option(name, default, meaning, metavar=metavar, many=True, together=True, **how)


_CASES = Argument("cases", meaning="output of 'make'", kind=Path, metavar="DIR")
_MAKE = (
    Option("out", meaning="folder to write, new or empty", kind=Path, metavar="DIR"),
    OVERWRITE,
    Option("seed", meaning="random seed", low=0, high=2**31, kind=int, metavar="N"),
    Option("cases", 100, "cases, a balanced sample of all combinations", 1, 100_000, kind=int, metavar="K"),
    _several("plants", (), f"kinds of plant (default: {' '.join(DEFAULT_PLANTS)})", choices=tuple(DAMPERS)),
    Option("recording", None, "learn one more plant, a map, from a recording of your damper", metavar="BAG"),
    SIGNALS,
    _several("kind", (), "effect, none, outside, pair (default: all)", choices=tuple(KINDS)),
    _several("effects", (), "library effects to draw from (default: all)", "NAME", choices=tuple(EFFECTS)),
    _several("gap_to_noise", (), "gap-to-noise ratios (default: 4 8 12 16)", "X", kind=float, low=0.1, high=100.0),
    _several("simulation_error", (), "its errors over the gap (default: 0 0.333 1)", "X", kind=float, low=0, high=10),
    Option("seconds", 20.0, "length of a recording", 2.0, 600.0, metavar="S"),
    *(JOBS, JSON),
)
_RUN = (
    replace(_CASES, meaning="output of 'make', or a copy with cases/ only"),
    Option("out", meaning="folder for results", kind=Path, metavar="RESULTS"),
    _several(
        "simulation",
        (RUN,),
        "what the diagnosis gets as simulation: one that it runs, recorded predictions, or a model identified from the "
        "references; every combination with --references is diagnosed into a folder of its own",
        choices=SIMULATIONS,
    ),
    _several("references", (2,), "how many reference recordings it gets", "N", low=0, high=MAX_REFERENCES),
    Option("limit", None, "only the first K cases", 1, 100_000, kind=int, metavar="K"),
    *(JOBS, JSON),
)
_SCORE = (
    _CASES,
    Argument(
        "results", (), "output of 'run', or the folder of one mode in it", kind=Path, metavar="RESULTS", count="+"
    ),
    Option("out", None, "also write the tables to this file", kind=Path, metavar="REPORT.md"),
    *(JSON, OVERWRITE),
)
_PARTS = {
    "make": ("draw cases, write their recordings and seal the answers", _make, _MAKE),
    "run": ("diagnose every case from its recordings; repeat to continue an interrupted run", run, _RUN),
    "score": ("open the seal and compare", _score, _SCORE),
}
