"""One cell: recordings in, a row of results and the model's text out. Runs in a worker, here or on another machine."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ces_identify.campaign.plan import AUTO, CampaignJob
from ces_identify.identification import IdentificationResult, identify
from ces_identify.jobs.job import DONE, JobResult, run_job
from ces_identify.jobs.row_log import Row
from ces_identify.polynomial.limits import Limits
from ces_identify.recordings.recording import Recording
from ces_identify.structures import KITS
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.validation.evaluate import Evaluation

REST = "rest"  # what `split` leaves of a recording, as a validation set
INTERRUPTED = "interrupted"


def compute_cell(job: CampaignJob, recordings: Sequence[Recording], _: Sequence[object] = ()) -> JobResult:
    """Identify and evaluate the model of a cell; `recordings` are those to identify on, then those to validate on.

    A search that Ctrl-C cut short raises KeyboardInterrupt: it is not the cell's result.
    """
    return run_job(job, partial(_identify_cell, job, recordings))


def _identify_cell(job: CampaignJob, recordings: Sequence[Recording]) -> JobResult:
    began = time.monotonic()
    count = len(job.recordings)
    fitter = KITS[job.cell.structure].fitter(job.cell.settings)
    result = identify(recordings[:count], recordings[count:], _options(job), fitter=fitter)
    if any(found.ended == INTERRUPTED for found in result.search_results):
        raise KeyboardInterrupt
    return JobResult(_row(job, result, time.monotonic() - began), {job.output: result.model.to_json()})


def _options(job: CampaignJob) -> IdentifyOptions:
    given, asked = job.cell.settings, job.limits
    limits = Limits(
        seconds=asked.seconds, target=asked.target, starts=asked.starts, seed=job.cell.seed, threads=asked.threads
    )
    if job.rules is not None:
        limits = replace(limits, max_terms=int(given["terms"]), method=str(given["method"]))
    rate_Hz, bandwidth_Hz = (None if given[k] == AUTO else float(given[k]) for k in ("rate_Hz", "bandwidth_Hz"))
    options = IdentifyOptions(job.split, limits=limits, rate_Hz=rate_Hz, bandwidth_Hz=bandwidth_Hz)
    options = replace(options, certify=bool(given["certificate"]))
    return replace(options, rules=job.rules) if job.rules is not None else options


def _row(job: CampaignJob, result: IdentificationResult, seconds: float) -> Row:
    best, certificate = result.search_results[0], result.model.certificate
    return {
        **job.identity,
        "status": DONE,
        "size": result.model.size,
        "parameters": len(best.coefficients),
        "selection_J": _finite(best.cost),
        "costs": _costs(job, result.evaluations),
        "gain": None if certificate is None else certificate.get("gain"),
        "seconds": round(seconds, 3),
        "trials": sum(found.trials for found in result.search_results),
        "ended": best.ended,
    }


def _costs(job: CampaignJob, evaluations: Sequence[Evaluation]) -> list[Row]:
    """Return a row for each evaluation: identification, what `split` left of those recordings, validation in turn."""
    given = len(evaluations) - len(job.validation)
    sets = ["identification"] * len(job.recordings) + [REST] * (given - len(job.recordings))
    sets += [name for name, _ in job.validation]
    return [
        {"set": name, "recording": e.name, "role": e.role, "J": _finite(e.cost), "rms_N": _finite(e.rms_N)}
        for name, e in zip(sets, evaluations, strict=True)
    ]


def _finite(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None
