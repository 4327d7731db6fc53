"""One cell: recordings in, a row of results and the model's text out. Runs in a worker on any machine."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial

import numpy as np

from ces_data.recording import Recording
from ces_identify.campaign.plan import AUTO, CampaignJob
from ces_identify.identification import identify
from ces_identify.jobs import DONE, JobResult, Row, run_job
from ces_identify.numerics.search import INTERRUPTED
from ces_identify.options import build_identify_options
from ces_identify.structures import KITS
from ces_identify.validation.evaluate import IDENTIFICATION, Evaluation

REST = "rest"  # the part of a recording after `split`, as a validation set


def compute_cell(job: CampaignJob, recordings: Sequence[Recording], _: Sequence[object] = ()) -> JobResult:
    """Identify and evaluate the model of a cell; `recordings` are the identification, then the validation data.

    A search that Ctrl-C interrupted raises KeyboardInterrupt: it is not the cell's result.
    """
    return run_job(job, partial(_identify_cell, job, recordings))


def _identify_cell(job: CampaignJob, recordings: Sequence[Recording]) -> JobResult:
    began, count, settings = time.monotonic(), len(job.recordings), job.cell.settings
    rate = None if settings["rate"] == AUTO else float(settings["rate"])
    options = build_identify_options(
        {**asdict(job.limits), **settings, "rate": rate, "split": job.split, "candidates": job.rules}
    )
    fitter = KITS[job.cell.structure].fitter(settings)
    result = identify(recordings[:count], recordings[count:], options, fitter=fitter)
    if any(start.ended == INTERRUPTED for start in result.search_results):
        raise KeyboardInterrupt
    result = result.require_explained(job.found, job.ignore_findings)
    seconds = time.monotonic() - began
    best, certificate = result.search_results[0], result.model.certificate or {}
    row = {
        **job.identity,
        "status": DONE,
        "size": result.model.size,
        "parameters": len(best.coefficients),
        "selection_J": _finite(best.cost),
        "costs": _costs(job, result.evaluations),
        "gain": certificate.get("gain"),
        "force_bound_N": certificate.get("force_bound_N"),
        "seconds": round(seconds, 3),
        "trials": sum(start.trials for start in result.search_results),
        "ended": best.ended,
    }
    return JobResult(row, {job.output: result.model.to_json()})


def _costs(job: CampaignJob, evaluations: Sequence[Evaluation]) -> list[Row]:
    """Return the costs of each evaluation.

    The sets are identification, the rest of those recordings after `split`, and the campaign's validation sets.
    """
    rest = len(evaluations) - len(job.validation) - len(job.recordings)
    names = [IDENTIFICATION] * len(job.recordings) + [REST] * rest + [name for name, _ in job.validation]
    return [
        {"set": name, "recording": e.name, "role": e.role, "J": _finite(e.cost), "rms_N": _finite(e.rms_N)}
        for name, e in zip(names, evaluations, strict=True)
    ]


def _finite(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None
