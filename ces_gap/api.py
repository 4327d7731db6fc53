"""The functions for scripts: diagnose a simulation and write the results. Import them from `ces_gap`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

from ces_data.reading import RecordingInputs, as_recordings
from ces_data.recording import Recording
from ces_gap import pipeline
from ces_gap.augmented import augmented_text, name_simulation
from ces_gap.calibrate.parameters import parameter_values
from ces_gap.diagnosis import Diagnosis
from ces_gap.effects.effect import Composition
from ces_gap.experiment.next_experiment import experiment_files
from ces_gap.inference.judgement import PARAMETERS
from ces_gap.inputs.checks import check_recordings
from ces_gap.pipeline import DiagnoseOptions
from ces_gap.progress import OptionalSteps, Progress, ignore_progress
from ces_gap.report.gap_json import format_document, gap_document
from ces_gap.report.page import report_page
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, Simulation
from ces_observer.json_text import write_all_atomically
from ces_observer.model import Model
from ces_report.typesetting import join_names


def diagnose(
    simulation: Simulation | Model | Callable[..., Any],
    real: RecordingInputs,
    *,
    held_out: RecordingInputs = (),
    reference: RecordingInputs = (),
    options: DiagnoseOptions | None = None,
    progress: Progress = ignore_progress,
) -> Diagnosis:
    """Return where the gap of a simulation to `real` recordings lies and which effects cause it.

    `simulation` is a model, a function of (time_s, position_m, current_A) that returns force_N, or any `Simulation`.
    `reference` recordings are free of the effect; `held_out` ones only judge (default: a part of `real`). `progress` is
    called with a text and a share. Raises CesError for what cannot be diagnosed.

        diagnosis = diagnose(my_damper, [worn], reference=[new])
        print(diagnosis.sentence)
    """
    recordings = as_recordings(real)
    held_out, reference = (as_recordings(some, required=False) for some in (held_out, reference))
    notes = check_recordings(recordings, held_out, reference)
    subject, name = _as_simulation(simulation)
    result = pipeline.diagnose(subject, name, recordings, held_out, reference, options, progress)
    return replace(result, notes=(*notes, *result.notes))


def write_diagnosis(diagnosis: Diagnosis, folder: str | Path) -> list[Path]:
    """Write gap.json, augmented.json, report.html and any next experiment into `folder`; return the paths.

    Raises CesError if the folder cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = result_files(diagnosis, name_simulation(diagnosis.simulation, folder), ())
    write_all_atomically({folder / name: text for name, text in files.items()})
    return [folder / name for name in files]


def _as_simulation(simulation: Simulation | Model | Callable[..., Any]) -> tuple[Simulation, str]:
    """Return the simulation and the name that results give it."""
    if isinstance(simulation, Model):
        return ModelSimulation(simulation), "model"
    if callable(simulation):
        name = f"{simulation.__module__}:{getattr(simulation, '__qualname__', 'function')}"
        return FunctionSimulation(name, simulation), name
    return simulation, getattr(simulation, "name", type(simulation).__name__)


GAP, AUGMENTED, REPORT = "gap.json", "augmented.json", "report.html"


def result_files(
    diagnosis: Diagnosis,
    sim: Mapping[str, str | None],
    sources: Sequence[tuple[str, Sequence[Recording]]],
    facts: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Return the texts of the files by name.

    `sim` specifies the simulation relative to the files' folder (`ces_gap.augmented.name_simulation`).
    `sources` are the recordings of each role ("real", "held_out", "reference") for the provenance; `facts` are shown in
    the report. If the report or the next experiment cannot be written, a note in `gap.json` says why.
    """
    optional, proposed = OptionalSteps(), diagnosis.next_experiment
    nothing: dict[str, str] = {}
    page = optional.run(REPORT, lambda: {REPORT: report_page(diagnosis, _title(diagnosis, sources), facts)}, nothing)
    experiment = optional.run("next experiment", lambda: experiment_files(proposed) if proposed else nothing, nothing)
    document = gap_document(replace(diagnosis, notes=(*diagnosis.notes, *optional.notes)))
    provenance = {role: [{"recording": r.name, "sha256": r.sha256} for r in recordings] for role, recordings in sources}
    composition = diagnosis.composition.composition
    said = {"verdict": diagnosis.verdict, "gap": document["gap"], **provenance}
    values, timing = parameter_values(composition), diagnosis.probe.corrected
    composition = Composition(tuple(s for s in composition.settings if s.name != PARAMETERS))
    augmented = augmented_text(
        sim, composition, diagnosis.correction, diagnosis.twin, diagnosis.is_recorded, said, timing, values
    )
    return {GAP: format_document(document), AUGMENTED: augmented, **page, **experiment}


def _title(diagnosis: Diagnosis, sources: Sequence[tuple[str, Sequence[Recording]]]) -> str:
    """Return which simulation was compared with which recordings, for the report's title."""
    names = {role: join_names([r.name for r in recordings]) for role, recordings in sources}
    real = join_names([r.name for role, recordings in sources if role != "reference" for r in recordings])
    reference = f" (reference {names['reference']})" if names.get("reference") else ""
    return f"Gap of {PurePath(diagnosis.simulation).name} against {real}{reference}"
