"""One unit of a fleet: its recordings in, a row and the texts of its files out. Runs in a worker, here or elsewhere."""

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
    """Diagnose one unit; `packed` holds the packed question alone."""
    return run_job(job, partial(_diagnose, job, packed[0], recordings))


def _diagnose(job: DiagnosisJob, packed: bytes, recordings: Sequence[Recording]) -> JobResult:
    began = time.monotonic()
    question: DiagnosisRequest = pickle.loads(packed)  # of our own making, never from a file
    doubts = check_recordings(recordings, (), question.reference)
    found = question.diagnose(question.simulation, question.spec, recordings, (), question.reference, question.options)
    found = replace(found, notes=(*doubts, *found.notes))
    files = question.files(found, job.sim, (("real", recordings), ("reference", question.reference)))
    row = {**_row(job, recordings, found), "seconds": round(time.monotonic() - began, 3)}
    return JobResult(row, {f"{job.output}/{name}": text for name, text in files.items()})


def _row(job: DiagnosisJob, recordings: Sequence[Recording], found: Diagnosis) -> Row:
    best = found.causes[0] if found.causes else None
    gap, together = found.gap, found.composition
    row: Row = {
        **job.identity,
        "status": DONE,
        "recordings": [r.name for r in recordings],
        "verdict": found.verdict,
        "effects": list(together.effects),
        "cause": best.effects[0] if best else None,
        "probability": _probability(found),
        "gap_N": gap.rms_N,
        "gap_low_N": gap.ci95_N[0],
        "gap_high_N": gap.ci95_N[1],
        "noise_floor_N": gap.noise_floor_N,
        "cost_J": gap.cost_J,
        "gap_after_N": together.gap_after_N,
        "shrink": together.shrink,
        "shrink_low": together.shrink_ci95[0],
        "shrink_high": together.shrink_ci95[1],
        "sentence": found.sentence,
        "notes": list(found.notes),
        "folder": job.output,
    }
    return {name: _plain(value) for name, value in row.items()}


def _probability(found: Diagnosis) -> float | None:
    """Return the probability of what the verdict says: of no gap, of something unknown, or of the likeliest effect."""
    if found.verdict in (NO_GAP, UNKNOWN):
        return found.probability_none if found.verdict == NO_GAP else found.probability_unknown
    return found.causes[0].probability if found.causes else None


def _plain(value: Any) -> Any:
    """Return a number rounded to six digits, None for one that is not finite, anything else as it is."""
    if not isinstance(value, float):
        return value
    return float(f"{value:.6g}") if abs(value) < float("inf") else None
