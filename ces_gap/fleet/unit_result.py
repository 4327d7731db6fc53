"""One unit of a fleet: its recordings in, a row and the texts of its files out. Runs in a worker."""

from __future__ import annotations

import pickle
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from ces_gap.diagnosis import NO_GAP, UNKNOWN, Diagnosis
from ces_gap.fleet.request import DiagnosisJob, DiagnosisRequest
from ces_gap.intake.checks import check_recordings
from ces_identify.jobs.job import DONE, JobResult, run_job
from ces_identify.jobs.row_log import Row
from ces_identify.recordings.recording import Recording


def diagnose_unit(job: DiagnosisJob, packed: Sequence[bytes], recordings: Sequence[Recording]) -> JobResult:
    """Diagnose one unit; `packed` holds the packed request as its only item."""
    return run_job(job, partial(_diagnose, job, packed[0], recordings))


def _diagnose(job: DiagnosisJob, packed: bytes, recordings: Sequence[Recording]) -> JobResult:
    start = time.monotonic()
    request: DiagnosisRequest = pickle.loads(packed)  # packed by this program, never read from a file
    notes = check_recordings(recordings, (), request.reference)
    diagnosis = request.diagnose(request.simulation, request.spec, recordings, (), request.reference, request.options)
    diagnosis = replace(diagnosis, notes=(*notes, *diagnosis.notes))
    files = request.files(diagnosis, job.sim, (("real", recordings), ("reference", request.reference)))
    row = {**_row(job, recordings, diagnosis), "seconds": round(time.monotonic() - start, 3)}
    return JobResult(row, {f"{job.output}/{name}": text for name, text in files.items()})


def _row(job: DiagnosisJob, recordings: Sequence[Recording], diagnosis: Diagnosis) -> Row:
    best = diagnosis.causes[0] if diagnosis.causes else None
    gap, together = diagnosis.gap, diagnosis.composition
    row: Row = {
        **job.identity,
        "status": DONE,
        "recordings": [r.name for r in recordings],
        "verdict": diagnosis.verdict,
        "effects": list(together.effects),
        "cause": best.effects[0] if best else None,
        "probability": _probability(diagnosis),
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
    return {name: _plain(value) for name, value in row.items()}


def _probability(diagnosis: Diagnosis) -> float | None:
    """Return the probability of the verdict: of no gap, of an unknown cause, or of the most probable effect."""
    if diagnosis.verdict in (NO_GAP, UNKNOWN):
        return diagnosis.probability_none if diagnosis.verdict == NO_GAP else diagnosis.probability_unknown
    return diagnosis.causes[0].probability if diagnosis.causes else None


def _plain(value: Any) -> Any:
    """Return a float rounded to six digits, None if it is not finite; other values unchanged."""
    if not isinstance(value, float):
        return value
    return float(f"{value:.6g}") if abs(value) < float("inf") else None
