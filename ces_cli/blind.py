"""`ces blind make|run|score`: tests the diagnosis on recordings with a withheld, sealed effect.

`run` diagnoses every case from its recordings alone; an interrupted run can be continued. Every mode has a folder of
its own in the folder for results. The seal is never opened: a folder with a copy of `cases/` is enough. The results
of a case are `gap.json`, `augmented.json`, `decision.json` (the figures behind the verdict), `replay.npz` with forces
[N] at the position samples of the held-out recordings (`NAME_simulated_N` of the simulation, `NAME_corrected_N` with
what references taught, `NAME_augmented_N` with the effects, too), and last `row.json`. A model that was identified in
place of the simulation is `model.json`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import inf
from operator import attrgetter
from pathlib import Path
from statistics import median
from typing import Any, cast

from rich.progress import track

from ces_cli.blind_case import diagnose_case
from ces_cli.terminal import terminal
from ces_cli.terminal.options import (
    JOBS,
    JSON,
    OVERWRITE,
    Argument,
    BagRequest,
    ProgramRequest,
    argument,
    only_with,
    option,
)
from ces_cli.terminal.outputs import print_document, without_text
from ces_cli.terminal.progress import JobsProgress
from ces_data.bags.find import find_bag
from ces_data.outputs import OUT, require_folder, require_outputs
from ces_data.signals_file import load_signals
from ces_identify.jobs import run_in_processes
from ces_observer.errors import CesError
from ces_observer.json_text import write_atomically
from ces_observer.records import declare
from ces_report.table import Table
from ces_rig.blind.cases import make_cases, open_seal, read_seal, remove_cases
from ces_rig.blind.metrics import group_cases, metric_table, mode_facts, withheld_table
from ces_rig.blind.plan import ERRORS, GAPS, KINDS, Levels, list_spare_effects, plan_sample
from ces_rig.blind.scoring import (
    MAX_REFERENCES,
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
from ces_rig.dampers.lookup.kernel import learn_lookup
from ces_rig.dampers.model import EFFECTS, OUTSIDE, RigDamper
from ces_rig.dampers.stepper import KINDS as DAMPERS

DEFAULT_PLANTS = ("lookup", "bouc_wen")  # their equations are not those of the diagnosis' twin
MAP = "map"  # the plant that --recording teaches
SLICES = {"gap-to-noise": "gap_to_noise", "simulation's error / gap": "baseline_ratio", "plant": "plant"}


def _several(
    default: Any, meaning: str, metavar: str = "KIND", low: float = -inf, high: float = inf, **how: Any
) -> Any:
    return option(default, meaning, low, high, metavar=metavar, together=True, **how)


CASES = Argument("cases", meaning="output of 'make'", kind=Path, metavar="DIR")


@dataclass(frozen=True, kw_only=True)
class MakeRequest(BagRequest):
    """Draw cases, write their recordings and seal the answers."""

    example = "ces blind make --out cases_1 --seed 1 --cases 100"

    out: Path = option(meaning="folder to write, new or empty", metavar="DIR")
    seed: int = option(meaning="random seed", low=0, high=2**31, metavar="N")
    cases: int = option(100, "cases, a balanced sample of all combinations", 1, 100_000, metavar="K")
    plants: tuple[str, ...] = _several(
        (), f"kinds of plant (default: {' '.join(DEFAULT_PLANTS)})", choices=tuple(DAMPERS)
    )
    recording: str | None = option(None, "learn one more plant, a map, from a recording of your damper", metavar="BAG")
    kind: tuple[str, ...] = _several((), "effect, none, outside, pair (default: all)", choices=tuple(KINDS))
    effects: tuple[str, ...] = _several(
        (), "library effects to draw from (default: all)", "NAME", choices=tuple(EFFECTS)
    )
    gap_to_noise: tuple[float, ...] = _several((), "gap-to-noise ratios (default: 4 8 12 16)", "X", 0.1, 100.0)
    simulation_error: tuple[float, ...] = _several((), "its errors over the gap (default: 0 0.333 1)", "X", 0, 10)
    seconds: float = option(20.0, "length of a recording", 2.0, 600.0, metavar="S")
    jobs: int | None = declare(JOBS)


@dataclass(frozen=True, kw_only=True)
class RunRequest(ProgramRequest):
    """Diagnose every case from its recordings; repeat to continue an interrupted run."""

    example = "ces blind run cases_1 --out results_1 --simulation run predictions --references 0 2"

    cases: Path = declare(replace(CASES, meaning="output of 'make', or a copy with cases/ only"))
    out: Path = option(meaning="folder for results", metavar="RESULTS")
    simulation: tuple[str, ...] = _several(
        (RUN,),
        "what the diagnosis gets as simulation: one that it runs, recorded predictions, or a model identified from "
        "the references; every combination with --references is diagnosed into a folder of its own",
        choices=SIMULATIONS,
    )
    references: tuple[int, ...] = _several((2,), "how many reference recordings it gets", "N", 0, MAX_REFERENCES)
    limit: int | None = option(None, "only the first K cases", 1, 100_000, metavar="K")
    jobs: int | None = declare(JOBS)
    json: bool = declare(JSON)


@dataclass(frozen=True, kw_only=True)
class ScoreRequest(ProgramRequest):
    """Open the seal and compare."""

    example = "ces blind score cases_1 results_1 --out blind.md"

    cases: Path = declare(CASES)
    results: tuple[Path, ...] = argument(
        (), "output of 'run', or the folder of one mode in it", metavar="RESULTS", count="+"
    )
    out: Path | None = option(None, "also write the tables to this file", metavar="REPORT.md")
    json: bool = declare(JSON)
    overwrite: bool = declare(OVERWRITE)


@dataclass(frozen=True, kw_only=True)
class BlindRequest(ProgramRequest):
    """Test the diagnosis on plants of the virtual rig with an effect that the simulation lacks.

    'make' draws cases by seed and seals the answers, 'run' diagnoses from the recordings alone, 'score' opens the seal
    and compares.
    """

    program = "blind"
    example = "\n  ".join(part.example for part in (MakeRequest, RunRequest, ScoreRequest))
    option_rules = (only_with("signals", "recording", "applies to --recording only; add it"),)
    parts = {"make": MakeRequest, "run": RunRequest, "score": ScoreRequest}  # noqa: RUF012 - of the class


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    request: ProgramRequest = terminal.read(BlindRequest, argv)
    if isinstance(request, MakeRequest):
        return _make(request)
    return run(request) if isinstance(request, RunRequest) else _score(cast(ScoreRequest, request))


def _make(request: MakeRequest) -> int:
    plants: dict[str, RigDamper] = {name: DAMPERS[name].design for name in request.plants or DEFAULT_PLANTS}
    if request.recording is not None:
        signals = load_signals(request.signals)
        plants[MAP] = learn_lookup(terminal.read_one(find_bag(request.recording), signals, terminal.FORCE))
    levels = Levels(
        effects=tuple(dict.fromkeys(request.effects or EFFECTS)),
        outside=OUTSIDE,
        plants=plants,
        kinds=tuple(dict.fromkeys(request.kind or KINDS)),
        gaps=tuple(request.gap_to_noise or GAPS),
        errors=tuple(request.simulation_error or ERRORS),
    )
    require_outputs(request.overwrite, folders={OUT: request.out})
    plan = plan_sample(levels, request.seed, request.cases)
    if request.overwrite:
        remove_cases(request.out)
    with JobsProgress(len(plan), 0, "cases") as progress:
        digest = make_cases(
            request.out,
            [(case, list_spare_effects(case, levels)) for case in plan],
            request.seconds,
            request.jobs or os.cpu_count() or 1,
            {"seed": request.seed, "planned": len(plan), "plants": list(levels.plants)},
            lambda label: progress.count(f"case {label.case} created"),
        )
    count_of = {kind: sum(case.kind == kind for case in plan) for kind in KINDS}
    if request.json:
        print_document("blind-make", {"folder": request.out, "cases": count_of, "sha256": digest})
    else:
        counts = ", ".join(f"{number} {kind}" for kind, number in count_of.items())
        print(f"{request.out}/cases: {counts}; answers sealed, SHA-256 {digest}")
    return 0


def run(request: RunRequest) -> int:
    """Diagnose the cases without a finished diagnosis, failed ones again; returns the exit status. Raises CesError."""
    modes = combine_modes(request.simulation, request.references)
    require_folder(request.out)
    cases = sorted(path.parent for path in request.cases.glob("cases/*/case.json"))[: request.limit]
    if not cases:
        raise CesError(f"{request.cases}: contains no cases/NNNN/case.json; expected the output of 'ces blind make'")
    for mode in modes:
        _require_same_settings(request.out / mode.name, {**asdict(mode), "seal": read_seal(request.cases)})
    failed = _diagnose_missing(
        [(case, request.out / m.name / case.name, m) for m in modes for case in cases], request.jobs
    )
    count, names = len(cases) * len(modes), [mode.name for mode in modes]
    with without_text(request.json):
        print(f"{request.out}: {count - len(failed)} of {count} diagnoses done ({', '.join(names)})")
    for where, reason in failed:
        terminal.print_warning(f"{where}: {reason}")
    if len(failed) == count:
        raise CesError(f"{request.cases}: none of the cases could be diagnosed, for the reasons above")
    if request.json:
        failures = [{"case": where, "reason": reason} for where, reason in failed]
        facts = {"folder": request.out, "modes": names, "diagnoses": count, "failed": failures}
        print_document("blind-run", facts)
    return 0


def _require_same_settings(results: Path, settings: dict[str, Any]) -> None:
    """Write the run's settings beside the results; raises CesError if results of other cases exist."""
    path = results / SETTINGS
    if path.is_file() and json.loads(path.read_text(encoding="utf-8")) != settings:
        raise CesError(f"{results}: holds results of other cases; choose another folder for ", OUT)
    results.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(settings) + "\n")


def _diagnose_missing(planned: Sequence[tuple[Path, Path, Mode]], jobs: int | None) -> list[tuple[str, str]]:
    """Diagnose the cases without a result, and return the modes and cases that failed, with the reason."""
    failed, missing = [], []
    for case, out, mode in planned:
        row = out / ROW
        if not row.is_file() or json.loads(row.read_text(encoding="utf-8"))["status"] != "done":
            missing.append((case, out, mode))
    with JobsProgress(len(planned), len(planned) - len(missing), "diagnoses") as progress:
        for done in run_in_processes(diagnose_case, missing, jobs or os.cpu_count() or 1, threads=1):
            where, is_failed = f"{done['mode']}, case {done['case']}", done["status"] != "done"
            text = done["reason"] if is_failed else done["summary"]
            progress.count(f"{where}: {text}, {done['seconds']:.1f} s", failed=is_failed)
            if is_failed:
                failed.append((where, done["reason"]))
    return sorted(failed)


def _score(request: ScoreRequest) -> int:
    """Score results against the seal, print the tables and write them; returns the exit status. Raises CesError."""
    require_outputs(request.overwrite, {OUT: request.out})
    sealed = open_seal(request.cases)
    by_mode: dict[str, list[CaseOutcome]] = {}
    parts: list[str | Table[Any]] = []
    for folder, mode in find_modes(request.results, request.cases):
        if mode.name in by_mode:
            raise CesError(f"{folder}: a second folder with results of mode {mode.name}; give one for each mode")
        shown = track(
            sealed.labels, "scoring", console=terminal.err, transient=True, disable=not terminal.err.is_terminal
        )
        outcomes, failed = score_cases(request.cases, folder, shown, mode)
        if outcomes:
            by_mode[mode.name] = outcomes
            parts += [f"## `{mode.name}`", _format_opening(outcomes, failed, len(sealed.labels), sealed.about)]
            groups = {title: group_cases(outcomes, attrgetter(key)) for title, key in SLICES.items()}
            parts += [*(metric_table(*group) for group in groups.items()), withheld_table(outcomes)]
    if not by_mode:
        raise CesError(
            f"{request.results[0]}: contains no diagnosis of a case of {request.cases}; run 'ces blind run' first"
        )
    parts = [metric_table("mode", by_mode), *parts]
    text = "\n\n".join(part if isinstance(part, str) else part.to_markdown() for part in parts)
    if request.json:
        print_document("blind-score", {"modes": {name: mode_facts(cases) for name, cases in by_mode.items()}})
    else:
        print(text)
    if request.out is not None:
        write_atomically(request.out, text + "\n")
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
