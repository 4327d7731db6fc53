"""The functions for scripts: diagnose a simulation and write the results. Import them from `ces_gap`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ces_data.reading import RecordingInputs, as_recordings
from ces_gap import pipeline
from ces_gap.augmented import name_simulation
from ces_gap.diagnosis import Diagnosis
from ces_gap.inputs.checks import check_recordings
from ces_gap.pipeline import DiagnoseOptions
from ces_gap.progress import Progress, ignore_progress
from ces_gap.report.result_files import result_files
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, Simulation
from ces_observer.json_text import write_all_atomically
from ces_observer.model import Model


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
