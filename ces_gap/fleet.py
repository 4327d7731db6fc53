"""Many diagnoses: their common request, a key for each result that identifies its inputs, and the work of one unit."""

from __future__ import annotations

import hashlib
import inspect
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ces_data.recording import Recording
from ces_gap.augmented import file_of, name_simulation
from ces_gap.diagnosis import NO_GAP, UNKNOWN, Diagnosis
from ces_gap.effects.library import class_of
from ces_gap.inputs.checks import check_recordings
from ces_gap.pipeline import DiagnoseOptions
from ces_gap.report.gap_json import to_plain_json
from ces_identify.jobs import DONE, JobResult, Row, run_job
from ces_identify.simulations.simulation import FunctionSimulation, Simulation
from ces_observer import __version__
from ces_observer.errors import OptionName

UNITS = "units"
OURS = ("ces_observer", "ces_identify", "ces_gap", "ces_rig", "ces_cli")


@dataclass(frozen=True)
class DiagnosisRequest:
    """The common part of all jobs: simulation, references and options.

    `diagnose` and `files` are `ces_gap.pipeline.diagnose` and `ces_gap.api.result_files`, or
    replacements of them.
    """

    simulation: Simulation
    spec: str
    reference: tuple[Recording, ...]
    options: DiagnoseOptions
    diagnose: Callable[..., Diagnosis]
    files: Callable[..., Mapping[str, str]]

    def digest(self) -> str:
        """Return a hash of everything that determines the results; `threads` does not."""
        inputs = {
            "tool": __version__,
            "sim": [self.spec, _file_digest(file_of(self.spec))],
            "code": sorted(_file_digest(Path(inspect.getsourcefile(m) or "")) for m in self._user_modules()),
            "effects": sorted(filter(None, map(class_of, self.options.effects))),
            "seed": self.options.seed,
            "tolerance": self.options.tolerance,
            "reference": [r.sha256 for r in self.reference],
        }
        return hashlib.sha256(json.dumps(inputs).encode()).hexdigest()

    def _user_modules(self) -> list[Any]:
        names = {type(effect).__module__ for effect in self.options.effects}
        if isinstance(self.simulation, FunctionSimulation):
            names.add(str(getattr(self.simulation.function, "__module__", "")))
        return [sys.modules[n] for n in sorted(names) if n in sys.modules and n.partition(".")[0] not in OURS]


@dataclass(frozen=True)
class DiagnosisJob:
    """One unit to diagnose: its name, the key of its result, and the folder of its files in the results folder.

    `sim` names the simulation relative to that folder.
    """

    key: str
    name: str
    output: str
    sim: Mapping[str, str | None] = field(compare=False)

    @property
    def identity(self) -> dict[str, Any]:
        """The columns that identify the unit of a row."""
        return {"key": self.key, "name": self.name}


def job_of(
    name: str, recordings: Sequence[Recording], request: DiagnosisRequest, signal_settings: str, folder: Path
) -> DiagnosisJob:
    """Return the job of a unit with files below `folder`; `signal_settings` describes how recordings were read."""
    inputs = [request.digest(), signal_settings, [r.sha256 for r in recordings]]
    key = hashlib.sha256(json.dumps(inputs).encode()).hexdigest()[:20]
    output = f"{UNITS}/{name}-{key[:8]}"
    return DiagnosisJob(key, name, output, name_simulation(request.spec, folder / output))


def _file_digest(file: Path | None) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file is not None and file.is_file() else ""


def diagnose_unit(job: DiagnosisJob, shared: Sequence[DiagnosisRequest], recordings: Sequence[Recording]) -> JobResult:
    """Diagnose one unit; `shared` holds the request as its only item."""

    def run() -> JobResult:
        start = time.monotonic()
        (request,) = shared
        reference = request.reference
        notes = check_recordings(recordings, (), reference)
        diagnosis = request.diagnose(request.simulation, request.spec, recordings, (), reference, request.options)
        diagnosis = replace(diagnosis, notes=(*notes, *diagnosis.notes))
        files = request.files(diagnosis, job.sim, (("real", recordings), ("reference", reference)))
        row = {**_row(job, recordings, diagnosis), "seconds": round(time.monotonic() - start, 3)}
        return JobResult(row, {f"{job.output}/{name}": text for name, text in files.items()})

    return run_job(job, run, OptionName.as_flag)  # of `ces diagnose --each`


def _row(job: DiagnosisJob, recordings: Sequence[Recording], diagnosis: Diagnosis) -> Row:
    best = diagnosis.causes[0] if diagnosis.causes else None
    gap, together = diagnosis.gap, diagnosis.composition
    of_verdict = {NO_GAP: diagnosis.probability_none, UNKNOWN: diagnosis.probability_unknown}
    row: Row = {
        **job.identity,
        "status": DONE,
        "recordings": [r.name for r in recordings],
        "verdict": diagnosis.verdict,
        "effects": list(together.effects),
        "cause": best.effects[0] if best else None,
        "probability": of_verdict.get(diagnosis.verdict, best.probability if best else None),
        "gap_N": gap.rms_N,
        "gap_low_N": gap.ci95_N[0],
        "gap_high_N": gap.ci95_N[1],
        "noise_floor_N": gap.noise_floor_N,
        "cost_J": gap.cost_J,
        "gap_after_N": together.gap_after_N,
        "shrink": together.shrink,
        "shrink_low": together.shrink_ci95[0],
        "shrink_high": together.shrink_ci95[1],
        "sentence": diagnosis.sentence,
        "notes": list(diagnosis.notes),
        "folder": job.output,
    }
    plain: Row = to_plain_json(row, job.name)
    return plain
