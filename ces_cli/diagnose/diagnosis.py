"""One diagnosis: from the options of `ces diagnose` to the result files and what the terminal shows."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.markup import escape

from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import HELP, RECORDING, VEHICLE, import_from_here, open_simulation, with_predictions
from ces_cli.terminal.options import FIT, HELD_OUT, JOBS, REAL, PageRequest, never_with, only_with, option
from ces_cli.terminal.outputs import make_schemas, print_document, without_text
from ces_cli.terminal.progress import DiagnoseProgress
from ces_data.bags.find import find_bags
from ces_data.recording import Recording, describe_days
from ces_data.signals_file import load_signals
from ces_gap.augmented import name_simulation
from ces_gap.baseline.identified import MODEL, identify_baseline
from ces_gap.calibrate.parameters import NONE
from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis, GapRegion, Interval, Where, find_best_other
from ces_gap.effects.library import user_effect
from ces_gap.inputs.checks import check_recordings
from ces_gap.limits import RegionLimits
from ces_gap.pipeline import DiagnoseOptions, diagnose
from ces_gap.progress import Progress
from ces_gap.report.formatting import region_name
from ces_gap.report.gap_json import gap_content, shrink_of_ceiling
from ces_gap.report.tables import calibration_table, cause_notes, cause_table, describe_explanation
from ces_gap.result_files import REPORT, result_files
from ces_identify.options import SEED, THREADS
from ces_identify.simulations.simulation import Simulation
from ces_identify.structures.auto import AUTO
from ces_observer.errors import CesError
from ces_observer.json_text import write_all_atomically
from ces_observer.records import declare
from ces_observer.signals import Signals
from ces_observer.structures import STRUCTURES
from ces_report.shell import PageHead

COLORS = {NAMED: "green", AMBIGUOUS: "yellow", UNKNOWN: "magenta", NO_GAP: "cyan"}
MAX_REGIONS = 3
OPTIONAL_FILES = (REPORT, "next_experiment.yaml", "next_experiment.csv")  # not every diagnosis writes these
NAMES = [structure.option for structure in STRUCTURES.values() if structure.is_offered]
REFERENCE = replace(
    HELD_OUT,
    none="",
    meaning="recordings known to be free of the effect; the simulation's own error is learned from them first",
)
FREED = replace(
    FIT,
    meaning=f"{FIT.meaning}; {NONE}: all keep their values. With --reference, those that may have changed since",
    none="all that the simulation declares compete with the effects; with --reference none",
)


@dataclass(frozen=True, kw_only=True)
class DiagnoseRequest(PageRequest):
    """Find where a simulation differs from recordings of the real damper, which missing effect is the cause, and how
    far the gap shrinks with that effect added. Writes gap.json, augmented.json (the simulation with the effects, itself
    a SIM), report.html and, where it would help, the next experiment.
    """

    program = "diagnose"
    example = (
        "ces diagnose --sim model.json --real worn/* --reference new/* --out gap\n"
        "  ces diagnose --identify --reference new/* --real worn/* --out gap\n"
        "  ces diagnose --sim damper.fmu --real 'fleet/*' --each vehicle --reference new/* --out fleet_gap"
    )
    option_rules = (
        only_with("structure", "identify", "applies to --identify; a simulation given by --sim has its own"),
        never_with(
            "sim",
            "identify",
            "does not apply with --identify, which takes a model of the references as simulation; remove one",
        ),
        only_with("jobs", "each", "applies to fleets; add --each recording or --each vehicle"),
        never_with("held_out", "each", "has no effect with --each: a part of each recording or vehicle is held out"),
        never_with("title note", "each", "has no effect with --each: every unit has a page of its own"),
        never_with("overwrite", "each", "has no effect with --each: the same command continues the fleet in --out"),
    )

    sim: str | None = option(None, HELP, metavar="SIM")
    identify: bool = option(
        False, "without --sim: identify a model of the --reference recordings and diagnose with it; DIR/model.json"
    )
    structure: str | None = option(
        None,
        "of the model that --identify fits; auto (default): the lowest cost on held-out parts of the references; "
        f"or {', '.join(NAMES)}",
        choices=(AUTO, *NAMES),
        metavar="NAME",
    )
    real: tuple[str, ...] = declare(REAL)
    held_out: tuple[str, ...] = declare(HELD_OUT)
    fit: tuple[str, ...] = declare(FREED)
    reference: tuple[str, ...] = declare(REFERENCE)
    out: Path = option(meaning="folder to write, created if necessary", metavar="DIR")
    effects: tuple[str, ...] = option(
        (),
        "your own effects in addition to the library's (subclasses of ces_gap.Effect)",
        metavar="module:Class",
        together=True,
    )
    threads: int | None = declare(
        replace(THREADS, meaning="default: all processors; with --each, one for each diagnosis", none="")
    )
    tolerance: float | None = option(
        None,
        "share of the RMS force below which a gap counts as none",
        0.0,
        100.0,
        unit="%",
        none="1, but at most twice the noise",
        metavar="PERCENT",
    )
    seed: int = declare(replace(SEED, meaning="random seed"))
    each: str | None = option(
        None,
        "one diagnosis for each recording of --real, or for each folder of recordings; the same command continues "
        "an interrupted run",
        choices=(RECORDING, VEHICLE),
    )
    jobs: int | None = declare(replace(JOBS, group="fleets"))


def run_diagnosis(request: DiagnoseRequest, command: str) -> None:
    """Diagnose --real, write the results to --out and print them; the report states `command`. Raises CesError."""
    require_one_source(request)
    how, signals = build_diagnose_options(request, os.cpu_count() or 1), load_signals(request.signals)
    given = None if request.sim is None else open_simulation(request.sim)
    roles = {"real": request.real, "held_out": request.held_out, "reference": request.reference}
    recordings = {
        role: [read_with_predictions(given, p, signals, request.part) for p in find_bags(words, repeated=True)]
        for role, words in roles.items()
    }
    real, held_out, reference = recordings.values()
    doubts = check_recordings(real, held_out, reference)
    for text in doubts:
        terminal.print_warning(text)
    with DiagnoseProgress() as progress:
        simulation, spec = take_simulation(given, reference, request, how.threads, progress.listen)
        diagnosis = diagnose(simulation, spec, real, held_out, reference, how, progress.listen)
        diagnosis = replace(diagnosis, notes=(*doubts, *diagnosis.notes))
        progress.listen("writing the report", 1.0)
        name = name_simulation(spec, request.out)
        recorded = describe_days(one for group in recordings.values() for one in group)
        head = PageHead(request.title, request.note, command, recorded)
        files = result_files(diagnosis, name, list(recordings.items()), head)
    make_schemas()  # the recipe of the next experiment names its schema
    problem = write_results(files, request.out)
    written = [name for name in files if problem is None or (request.out / name).is_file()]
    with without_text(request.json):
        print_diagnosis(diagnosis, request.out, written, printed_notes=len(doubts))
    if request.json:
        print_document("diagnose", {"folder": request.out, "files": written, "diagnosis": gap_content(diagnosis)})
    if problem is not None:  # only now: what took minutes is at least shown
        raise problem


def write_results(files: Mapping[str, str], folder: Path) -> CesError | None:
    """Write the files of a diagnosis, the report last, in place of those of an earlier one; return what went wrong."""
    data = {folder / name: text for name, text in files.items() if name != REPORT}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_all_atomically(data)
        for old in {*OPTIONAL_FILES} - {*files}:
            (folder / old).unlink(missing_ok=True)
    except CesError as error:
        return error
    try:
        write_all_atomically({folder / REPORT: files[REPORT]} if REPORT in files else {})
    except CesError as error:
        (folder / REPORT).unlink(missing_ok=True)  # of an earlier diagnosis
        return CesError(f"{error} with --overwrite; {', '.join(path.name for path in data)} are complete")
    return None


def build_diagnose_options(request: DiagnoseRequest, threads: int) -> DiagnoseOptions:
    """Return the settings of the diagnosis, with the user's own effects; `threads` is the default of --threads."""
    import_from_here()
    effects = tuple(user_effect(spec) for spec in request.effects)
    threads, tolerance = request.threads or threads, None if request.tolerance is None else 0.01 * request.tolerance
    return DiagnoseOptions(effects=effects, threads=threads, seed=request.seed, tolerance=tolerance, fit=request.fit)


def read_with_predictions(
    simulation: Simulation | None, path: Path, signals: Signals, part: Sequence[float]
) -> Recording:
    """Return a recording, or the part of it, with its measured force and, if recorded there, the simulation's force."""
    recording = terminal.read_one(path, signals, terminal.FORCE, part)
    return recording if simulation is None else with_predictions(simulation, path, recording, signals)


def require_one_source(request: DiagnoseRequest) -> None:
    """Raise CesError unless the options give a simulation or references to identify one from."""
    if not request.identify and request.sim is None:
        raise CesError("no simulation: give --sim SIM, or --identify with --reference BAG...")
    if request.identify and not request.reference:
        raise CesError("--identify needs --reference BAG...: recordings free of the effect, from which to identify")


def take_simulation(
    given: Simulation | None, reference: Sequence[Recording], request: DiagnoseRequest, threads: int, progress: Progress
) -> tuple[Simulation, str]:
    """Return the simulation and its name: the one `given`, or a model of the references, saved in --out."""
    if given is not None:
        return given, str(request.sim)
    structure = request.structure or AUTO
    baseline = identify_baseline(reference, structure=structure, threads=threads, progress=progress)
    request.out.mkdir(parents=True, exist_ok=True)
    saved = baseline.save(request.out / MODEL)
    return saved, saved.name


def print_diagnosis(diagnosis: Diagnosis, folder: Path, files: Sequence[str], printed_notes: int = 0) -> None:
    """Print a diagnosis and the `files` written to `folder`; the first `printed_notes` notes are already printed."""
    for text in diagnosis.notes[printed_notes:]:
        terminal.print_warning(text)
    name, style = diagnosis.verdict.replace("_", " ").upper(), f"bold {COLORS[diagnosis.verdict]}"
    terminal.out.print(f"[{style}]{name}[/]: {escape(diagnosis.sentence)}", highlight=False, soft_wrap=True)
    _print_lines(_gap_lines(diagnosis))
    if diagnosis.causes and diagnosis.verdict != NO_GAP:
        terminal.print_table(terminal.lay_out(cause_table(diagnosis), lambda row: "bold" * (row.css == "named")))
        _print_lines(cause_notes(diagnosis))
    _print_lines(describe_explanation(diagnosis.composition))
    if (recalibration := calibration_table(diagnosis)) is not None:
        terminal.print_table(terminal.lay_out(recalibration))
    if diagnosis.probe.findings:
        probed = (f"{one.about.lower()} {one.found}" for one in diagnosis.probe.findings)
        terminal.print_line(f"inputs of the simulation: {'; '.join(probed)} (see the report)")
    if diagnosis.verdict != NO_GAP:
        _print_lines(_where_lines("where", diagnosis.where))
    if diagnosis.rest is not None:
        _print_lines(_where_lines("unexplained", diagnosis.rest))
    _print_lines([*_ambiguity_lines(diagnosis), *_next_lines(diagnosis, folder)])
    if files:
        print(f"written: {folder}/{', '.join(files)}")


def _print_lines(lines: Sequence[str]) -> None:
    for line in lines:
        terminal.print_line(line)


def _gap_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the size of the gap, how much of it remains, and how much controls leave."""
    gap, together = diagnosis.gap, diagnosis.composition
    wrong = find_best_other(diagnosis, together)
    lines = [
        f"gap: {_newtons(gap.rms_N)} RMS {_interval(gap.ci95_N)} on held-out data, J = {gap.cost_J:.2f} % "
        f"(noise {_newtons(gap.noise_floor_N)} from {gap.noise_source}, {gap.noise_in_band}subtracted)"
    ]
    errors = ["own error, learned from the references"] * (diagnosis.correction is not None)
    errors += ["timing of its inputs"] * bool(diagnosis.probe.corrected)
    if errors:
        size = f"{_newtons(gap.corrected_N)} {_interval(gap.corrected_ci95_N)}"
        lines.append(f"     {size} of it beyond the simulation's {' and the '.join(errors)}")
    if together.effects:
        low, high = (100.0 * share for share in together.shrink_ci95)
        interval = f"[{low:.0f}, {high:.0f}]" if math.isfinite(low + high) else "unknown"
        lines.append(
            f"with {' + '.join(together.effects)}: {_newtons(together.gap_after_N)} left, the gap shrinks by "
            f"{_percent(together.shrink)} {interval}"
        )
        ceiling = shrink_of_ceiling(diagnosis)
        other = "" if wrong is None else f"the best other effect ({wrong.effects[0]}) {_percent(wrong.shrink)}, "
        lines.append(f"     for comparison: {other}a learner without physics {_percent(ceiling)}")
    return lines


def _where_lines(label: str, where: Where) -> list[str]:
    """Return the regions with more of the gap's energy than of the time."""
    regions = [
        r
        for r in where.regions
        if r.q_value <= RegionLimits.SIGNIFICANT
        and r.share_of_energy > max(RegionLimits.MIN_ENERGY_RATIO * r.share_of_samples, RegionLimits.MIN_ENERGY_SHARE)
    ]
    regions.sort(key=lambda r: r.share_of_samples - r.share_of_energy)
    by_axis = {r.axis: r for r in reversed(regions)}
    best = [r for r in regions if by_axis[r.axis] is r][:MAX_REGIONS]
    return [f"{label}: {_describe_region(r)}" for r in best] or [f"{label}: no region stands out"]


def _describe_region(region: GapRegion) -> str:
    energy = f"{region.share_of_energy:.0%} of the gap's energy"
    if region.axis == "frequency_hz":
        return f"{energy} at {region_name(region)}"
    time = f"{region.share_of_samples:.0%} of the time"
    return f"{energy} in {time} at {region_name(region)} (RMS {_newtons(region.rms_N)})"


def _ambiguity_lines(diagnosis: Diagnosis) -> list[str]:
    """Return what these recordings cannot decide."""
    lines = [f"indistinguishable on these recordings: {', '.join(group)}" for group in diagnosis.indistinguishable]
    if diagnosis.not_separable:
        effects = ", ".join(diagnosis.not_separable)
        lines.append(f"not separable from a calibration of the simulation: {effects} (use --reference)")
    lines += [f"not observable: {effect}: {reason}" for effect, reason in diagnosis.invisible]
    if diagnosis.is_recorded and diagnosis.twin is not None:
        lines.append(f"a twin with J = {diagnosis.twin.cost_J:.2f} % replaced the simulation")
    return lines


def _next_lines(diagnosis: Diagnosis, folder: Path) -> list[str]:
    lines = []
    if diagnosis.next_experiment is not None:
        lines.append(f"next: {diagnosis.next_experiment.purpose}")
        lines.append(f"      ces rig {folder}/next_experiment.yaml --out BAG   (for a real rig: next_experiment.csv)")
    if diagnosis.composition.effects and diagnosis.verdict in (NAMED, AMBIGUOUS):
        command = f"ces identify --teacher {folder}/augmented.json BAG... --out MODEL.json"
        lines.append(f"next: {command}   (the repaired simulation as a model)")
    return lines


def _newtons(value: float) -> str:
    return f"{value:.1f} N" if math.isfinite(value) else "unknown"


def _interval(bounds: Interval) -> str:
    return f"[{bounds[0]:.1f}, {bounds[1]:.1f}]"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if math.isfinite(share) else "unknown"
