"""One cell: recordings in, a row of results and the model's text out. Runs in a worker on any machine."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial

import numpy as np

from ces_data.recording import Recording
from ces_identify.campaign.plan import AUTO, CampaignJob
from ces_identify.comparison.compared_models import TickTime, measure_tick_times
from ces_identify.identification import IdentificationResult, identify
from ces_identify.jobs.results import DONE, JobResult, Row, run_job
from ces_identify.options import build_identify_options
from ces_identify.structures import KITS
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.validation.evaluate import IDENTIFICATION, Evaluation, cost_interval, pooled_cost

REST = "rest"  # the part of a recording after `split`, as a validation set
INTERRUPTED = "interrupted"


def compute_cell(job: CampaignJob, recordings: Sequence[Recording], _: Sequence[object] = ()) -> JobResult:
    """Identify and evaluate the model of a cell; `recordings` are the identification, then the validation data.

    A search that Ctrl-C interrupted raises KeyboardInterrupt: it is not the cell's result.
    """
    return run_job(job, partial(_identify_cell, job, recordings))


def _identify_cell(job: CampaignJob, recordings: Sequence[Recording]) -> JobResult:
    began = time.monotonic()
    count = len(job.recordings)
    fitter = KITS[job.cell.structure].fitter(job.cell.settings)
    result = identify(recordings[:count], recordings[count:], _options(job), fitter=fitter)
    result = result.with_ignored_findings(job.forced)
    if any(start.ended == INTERRUPTED for start in result.search_results):
        raise KeyboardInterrupt
    seconds = time.monotonic() - began
    (tick,) = measure_tick_times([result.model], recordings[0])
    return JobResult(_row(job, result, seconds, tick), {job.output: result.model.to_json()})


def _options(job: CampaignJob) -> IdentifyOptions:
    settings = job.cell.settings
    sampling = {key: None if settings[key] == AUTO else float(settings[key]) for key in ("rate", "bandwidth")}
    given = {**asdict(job.limits), **settings, **sampling}
    return build_identify_options({**given, "split": job.split, "candidates": job.rules})


def _row(job: CampaignJob, result: IdentificationResult, seconds: float, tick: TickTime) -> Row:
    best, certificate = result.search_results[0], result.model.certificate
    return {
        **job.identity,
        "status": DONE,
        "size": result.model.size,
        "parameters": len(best.coefficients),
        "selection_J": _finite(best.cost),
        "costs": _costs(job, result.evaluations),
        "pooled": _pooled_costs(job, result.evaluations),
        "gain": None if certificate is None else certificate.get("gain"),
        "force_bound_N": None if certificate is None else certificate.get("force_bound_N"),
        "tick_us": round(tick.fastest_us, 2),
        "seconds": round(seconds, 3),
        "trials": sum(start.trials for start in result.search_results),
        "ended": best.ended,
    }


def _costs(job: CampaignJob, evaluations: Sequence[Evaluation]) -> list[Row]:
    """Return a row for each evaluation."""
    return [
        {"set": name, "recording": e.name, "role": e.role, "J": _finite(e.cost), "rms_N": _finite(e.rms_N)}
        for name, e in zip(_set_names(job, evaluations), evaluations, strict=True)
    ]


def _pooled_costs(job: CampaignJob, evaluations: Sequence[Evaluation]) -> Row:
    """Return J over all recordings of each validation set, with its interval (None if it diverged or is too short)."""
    sets: dict[str, list[Evaluation]] = {}
    for name, evaluation in zip(_set_names(job, evaluations), evaluations, strict=True):
        if name != IDENTIFICATION:
            sets.setdefault(name, []).append(evaluation)
    return {name: _pooled_cost(members) for name, members in sets.items()}


def _pooled_cost(evaluations: Sequence[Evaluation]) -> Row:
    interval = cost_interval(evaluations)
    ends = None if interval is None else [_finite(interval.low), _finite(interval.high)]
    return {"J": _finite(pooled_cost(evaluations)), "ci95": ends}


def _set_names(job: CampaignJob, evaluations: Sequence[Evaluation]) -> list[str]:
    """Return the set of each evaluation: identification, the rest of those recordings after `split`, validation."""
    rest = len(evaluations) - len(job.validation) - len(job.recordings)
    return [IDENTIFICATION] * len(job.recordings) + [REST] * rest + [name for name, _ in job.validation]


def _finite(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None
