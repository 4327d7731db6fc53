"""`ces blind make|run|score`: tests the diagnosis on recordings with a withheld, sealed effect.

`run` diagnoses every case from its recordings alone; an interrupted run can be continued. Every mode has a folder of
its own in the folder for results. The seal is never opened: a folder with a copy of `cases/` is enough. The results
of a case are `gap.json`, `augmented.json`, `decision.json` (the figures behind the verdict), `replay.npz` with forces
[N] at the position samples of the held-out recordings (`NAME_simulated_N` of the simulation, `NAME_corrected_N` with
what references taught, `NAME_augmented_N` with the effects, too), and last `row.json`. A model that was identified in
place of the simulation is `model.json`.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import time
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from operator import attrgetter
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import track

from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import find_bag, open_simulation, with_predictions
from ces_cli.terminal.options import JOBS, JSON, OVERWRITE, SIGNALS, Argument, only_with
from ces_cli.terminal.outputs import print_document, require_folder, require_outputs, without_text
from ces_cli.terminal.progress import JobsProgress
from ces_data.bags.reader import read_recording
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_identify.identification import identify
from ces_identify.jobs import run_in_processes
from ces_identify.numerics.search import Limits
from ces_identify.simulations.simulation import Simulation
from ces_identify.structures import KITS
from ces_identify.structures.auto import physical_structures
from ces_identify.structures.kit import IdentifyOptions
from ces_observer.errors import CesError
from ces_observer.json_text import write_atomically
from ces_observer.options import Option
from ces_report.table import Table
from ces_rig.blind.cases import make_cases, open_seal, read_seal, remove_cases
from ces_rig.blind.metrics import group_cases, metric_table, mode_facts, withheld_table
from ces_rig.blind.plan import ERRORS, GAPS, KINDS, Levels, list_spare_effects, plan_sample
from ces_rig.blind.scoring import (
    DECISION,
    GAP,
    IDENTIFIED,
    MAX_REFERENCES,
    PREDICTIONS,
    REPLAY,
    ROW,
    RUN,
    SETTINGS,
    SIMULATIONS,
    CaseOutcome,
    Mode,
    combine_modes,
    find_modes,
    score_cases,
)
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


AUGMENTED, MODEL = "augmented.json", "model.json"
WORK = 0.12  # of a fit
OPTIONS = IdentifyOptions(split=1.0, limits=Limits(starts=1, threads=1, work=WORK), band=False)


def run(options: argparse.Namespace) -> int:
    """Diagnose the cases without a finished diagnosis, failed ones again; returns the exit status. Raises CesError."""
    modes = combine_modes(options.simulation, options.references)
    require_folder(options.out)
    cases = sorted(path.parent for path in options.cases.glob("cases/*/case.json"))[: options.limit]
    if not cases:
        raise CesError(f"{options.cases}: contains no cases/NNNN/case.json; expected the output of 'ces blind make'")
    for mode in modes:
        _require_same_settings(options.out / mode.name, {**asdict(mode), "seal": read_seal(options.cases)})
    failed = _diagnose_missing([(case, options.out / m.name / case.name, m) for m in modes for case in cases], options)
    count, names = len(cases) * len(modes), [mode.name for mode in modes]
    with without_text(options.json):
        print(f"{options.out}: {count - len(failed)} of {count} diagnoses done ({', '.join(names)})")
    for where, reason in failed:
        terminal.print_warning(f"{where}: {reason}")
    if len(failed) == count:
        raise CesError(f"{options.cases}: none of the cases could be diagnosed, for the reasons above")
    if options.json:
        failures = [{"case": where, "reason": reason} for where, reason in failed]
        facts = {"folder": options.out, "modes": names, "diagnoses": count, "failed": failures}
        print_document("blind-run", facts)
    return 0


def _require_same_settings(results: Path, settings: dict[str, Any]) -> None:
    """Write the run's settings beside the results; raises CesError if results of other cases exist."""
    path = results / SETTINGS
    if path.is_file() and json.loads(path.read_text(encoding="utf-8")) != settings:
        raise CesError(f"{results}: holds results of other cases; choose another folder for --out")
    results.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(settings) + "\n")


def _diagnose_missing(planned: Sequence[tuple[Path, Path, Mode]], options: argparse.Namespace) -> list[tuple[str, str]]:
    """Diagnose the cases without a result, and return the modes and cases that failed, with the reason."""
    failed, missing = [], []
    for case, out, mode in planned:
        row = out / ROW
        if not row.is_file() or json.loads(row.read_text(encoding="utf-8"))["status"] != "done":
            missing.append((case, out, mode))
    with JobsProgress(len(planned), len(planned) - len(missing), "diagnoses") as progress:
        for done in run_in_processes(diagnose_case, missing, options.jobs or os.cpu_count() or 1, threads=1):
            where, is_failed = f"{done['mode']}, case {done['case']}", done["status"] != "done"
            text = done["reason"] if is_failed else done["summary"]
            progress.count(f"{where}: {text}, {done['seconds']:.1f} s", failed=is_failed)
            if is_failed:
                failed.append((where, done["reason"]))
    return sorted(failed)


def diagnose_case(case: Path, out: Path, mode: Mode) -> dict[str, Any]:
    """Diagnose the case, write its results and return a row: the summary or the reason of failure, and the seconds."""
    start = time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    row: dict[str, Any] = {"case": case.name, "status": "done"}
    try:
        row["summary"] = _diagnose(case, out, mode)
    except CesError as error:
        row |= {"status": "failed", "reason": str(error)}
    except Exception as error:  # a fault of the diagnosis counts as its result; the other cases continue
        logging.getLogger(__name__).exception("%s", case)
        row |= {"status": "failed", "reason": f"{type(error).__name__}: {error}"}
    row["seconds"] = round(time.perf_counter() - start, 2)
    write_atomically(out / ROW, json.dumps(row) + "\n")
    return {**row, "mode": mode.name}


def _diagnose(case: Path, out: Path, mode: Mode) -> str:
    """Diagnose the case and write its results; return a line."""
    from ces_gap.augmented import save_augmented
    from ces_gap.inputs.checks import require_distinct
    from ces_gap.pipeline import DiagnoseOptions, diagnose
    from ces_gap.report.gap_json import write_gap

    described = json.loads((case / "case.json").read_text(encoding="utf-8"))
    if len(described["reference"]) < mode.references:
        raise CesError(
            f"{case}: has {len(described['reference'])} references; expected {mode.references} for {mode.name}"
        )
    spec = _prepare_simulation(case, out, described, mode)
    simulation = open_simulation(spec)
    real, held_out = (_read(simulation, case, described[role]) for role in ("real", "held_out"))
    reference = _read(simulation, case, described["reference"][: mode.references])
    require_distinct(real, held_out, reference)
    options = DiagnoseOptions(threads=1, experiment=False)
    diagnosis = diagnose(simulation, spec, real, held_out, reference, options)
    write_gap(out / GAP, diagnosis)
    explanation = diagnosis.composition.composition, diagnosis.correction, diagnosis.twin, diagnosis.is_recorded
    save_augmented(out / AUGMENTED, spec, *explanation, timing=diagnosis.probe.corrected)
    figures = None if diagnosis.figures is None else asdict(diagnosis.figures)  # behind the verdict
    write_atomically(out / DECISION, json.dumps({"figures": figures}, indent=1) + "\n")
    _replay(out, simulation, held_out)
    gap = json.loads((out / GAP).read_text(encoding="utf-8"))
    effects = " + ".join(gap["composition"]["effects"]) or "nothing"
    before, after = gap["gap"]["rms_N"] or 0.0, gap["composition"]["gap_after_N"] or 0.0
    return f"{gap['verdict']}, {effects}; gap {before:.1f} N, left {after:.1f} N"


def _prepare_simulation(case: Path, out: Path, described: Mapping[str, Any], mode: Mode) -> str:
    """Return the specification of the mode's simulation; an identified one is written to MODEL first."""
    if mode.simulation == PREDICTIONS:
        return str(described["predictions"])
    if mode.simulation == IDENTIFIED:
        identify_baseline(_read_bags(case, described["reference"][: mode.references]), out / MODEL)
        return str(out / MODEL)
    inside = case / described["simulation"]
    return str(inside) if inside.is_file() else str(described["simulation"])  # one of its own, such as module:function


def _read(simulation: Simulation, case: Path, names: Sequence[str]) -> list[Recording]:
    recordings = zip(names, _read_bags(case, names), strict=True)
    return [with_predictions(simulation, case / name, recording, load_signals()) for name, recording in recordings]


def _read_bags(case: Path, names: Sequence[str]) -> list[Recording]:
    signals = load_signals()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # every case: the message of the current has no header
        return [read_recording(case / name, signals, ("position", "current", "force")) for name in names]


def _replay(out: Path, simulation: Simulation, held_out: Sequence[Recording]) -> None:
    """Run the simulation over the held-out recordings, as it is, with its correction, and with effects too."""
    from ces_gap.augmented import load_augmented
    from ces_gap.effects.effect import Composition

    augmented = load_augmented(out / AUGMENTED, open_simulation)
    corrected = replace(augmented, composition=Composition())
    arrays: dict[str, NDArray[np.float32]] = {}
    for name, what in (("simulated", simulation), ("corrected", corrected), ("augmented", augmented)):
        arrays |= {f"{r.name}_{name}_N": what.force(r).astype(np.float32) for r in held_out}
    part = out / f".part.{REPLAY}"
    np.savez_compressed(part, **arrays)  # type: ignore[arg-type]
    part.replace(out / REPLAY)


def identify_baseline(references: Sequence[Recording], path: Path) -> None:
    """Write to `path` the model with physics inside of the lowest selection cost on the references; raises CesError."""
    models = []
    for option in physical_structures():
        kit = KITS[option]
        fitter = kit.fitter({size.name: size.default for size in kit.sizes})
        with warnings.catch_warnings(), suppress(CesError):
            warnings.simplefilter("ignore")
            models.append(identify(references, (), OPTIONS, lambda result: None, fitter))
    if not models:
        raise CesError("no model could be identified from the reference recordings")
    min(models, key=lambda result: float(result.search_results[0].cost)).model.save(path)


def _score(options: argparse.Namespace) -> int:
    """Score results against the seal, print the tables and write them; returns the exit status. Raises CesError."""
    require_outputs(options.overwrite, {"--out": options.out})
    about, labels = open_seal(options.cases)
    by_mode: dict[str, list[CaseOutcome]] = {}
    parts: list[str | Table[Any]] = []
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
    text = "\n\n".join(part if isinstance(part, str) else part.to_markdown() for part in parts)
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
