"""Cells of a campaign: recordings in, a row of results and the model's text out; what the rows of all cells say.

A cell runs in a worker on any machine. Rows have names by the settings that vary; on the front of cost against size are
the models that no other beats in both, and one of them is recommended.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial

import numpy as np

from ces_data.recording import Recording
from ces_identify.campaign.plan import AUTO, Campaign, CampaignJob
from ces_identify.identification import identify
from ces_identify.jobs import DONE, JobResult, Row, run_job
from ces_identify.limits import ChoiceLimits
from ces_identify.numerics.search import INTERRUPTED
from ces_identify.options import IdentifyRequest
from ces_identify.validation.evaluate import IDENTIFICATION, Evaluation
from ces_observer.errors import OptionName

REST = "rest"  # the part of a recording after `split`, as a validation set
COUNTED = ("terms", "units", "rules", "curves")


def compute_cell(job: CampaignJob, recordings: Sequence[Recording], _: Sequence[object] = ()) -> JobResult:
    """Identify and evaluate the model of a cell; `recordings` are the identification, then the validation data.

    A search that Ctrl-C interrupted raises KeyboardInterrupt: it is not the cell's result.
    """
    return run_job(job, partial(_identify_cell, job, recordings), OptionName.as_key)


def _identify_cell(job: CampaignJob, recordings: Sequence[Recording]) -> JobResult:
    began, count, settings = time.monotonic(), len(job.recordings), job.cell.settings
    rate = None if settings["rate"] == AUTO else float(settings["rate"])
    given = {**asdict(job.limits), **settings, "rate": rate, "split": job.split, "candidates": job.rules}
    request = IdentifyRequest.of({**given, "structure": job.cell.structure})
    result = identify(recordings[:count], recordings[count:], request.options(), fitter=request.fitter())
    if any(start.ended == INTERRUPTED for start in result.search_results):
        raise KeyboardInterrupt
    result = result.require_explained(job.findings, job.ignore_findings)
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
    unseen = len(evaluations) - len(job.validation) - len(job.recordings)
    names = [IDENTIFICATION] * len(job.recordings) + [REST] * unseen + [name for name, _ in job.validation]
    return [
        {"set": name, "recording": e.name, "role": e.role, "J": _finite(e.cost), "rms_N": _finite(e.rms_N)}
        for name, e in zip(names, evaluations, strict=True)
    ]


def _finite(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None


@dataclass(frozen=True)
class CellNames:
    """Names cells by their structure and the settings in `varied`, and with their set of bags if there are several."""

    varied: tuple[str, ...]
    with_bags: bool

    @classmethod
    def of(cls, campaign: Campaign) -> CellNames:
        """Return the names of a campaign's cells, by the settings that vary in it."""
        axes = [axis for own in (*campaign.structures.values(), campaign.common) for axis in own.items()]
        varied = dict.fromkeys(name for name, values in axes if len(values) > 1)
        return cls(tuple(varied), len(campaign.bags) > 1)

    def name(self, row: Row) -> str:
        """Return the structure of a cell and its settings that vary: polynomial, 12 terms, seed 1."""
        return ", ".join(filter(None, [row["structure"], self.settings(row)]))

    def full_name(self, row: Row) -> str:
        """Return the name of a cell with its set of bags, if there are several."""
        return f"{row['bags']}: {self.name(row)}" if self.with_bags else self.name(row)

    def settings(self, row: Row) -> str:
        """Return the settings of a cell that vary: 12 terms, seed 1."""
        return ", ".join(describe_setting(key, row) for key in self.varied if key in row)


def describe_setting(key: str, row: Row) -> str:
    """Return a setting of a row as text: 12 terms, seed 1, certificate yes."""
    value = row[key]
    if isinstance(value, bool):
        return f"{key} {'yes' if value else 'no'}"
    if key == "delay":
        return f"delay {1e3 * value:g} ms"
    return f"{value} {key}" if key in COUNTED else f"{key} {value}"


def front(rows: Sequence[Row]) -> list[Row]:
    """Return the rows that no other beats in both size and selection cost, smallest model first.

    All rows belong to one set of bags. Models without a certificate count only if none has one.
    """
    best: list[Row] = []
    models = [row for row in rows if row["status"] == DONE and row["selection_J"] is not None]
    models = [row for row in models if is_proved(row)] or models
    for row in sorted(models, key=lambda r: (r["parameters"], r["selection_J"])):
        if not best or row["selection_J"] < best[-1]["selection_J"]:
            best.append(row)
    return best


def is_proved(row: Row) -> bool:
    """Return whether the row's model has a certificate."""
    return row.get("force_bound_N") is not None


def recommend_model(rows: Sequence[Row]) -> Row | None:
    """Return the smallest model on the front within 10 % of its lowest cost, None if there is no model."""
    best = front(rows)
    return next(
        (row for row in best if row["selection_J"] <= (1.0 + ChoiceLimits.COST_TOLERANCE) * best[-1]["selection_J"]),
        None,
    )


@dataclass(frozen=True)
class CampaignRows:
    """The rows of a campaign's cells that have a result, of `planned` cells in all, and the names of the cells."""

    rows: tuple[Row, ...]
    planned: int
    names: CellNames

    @cached_property
    def done(self) -> list[Row]:
        """Cells with a model, by their selection cost."""
        rows = [row for row in self.rows if row["status"] == DONE]
        return sorted(rows, key=lambda row: (row["selection_J"] is None, row["selection_J"] or 0.0))

    @cached_property
    def bags(self) -> list[str]:
        """Sets of bags that models were identified on."""
        return list(dict.fromkeys(row["bags"] for row in self.rows))

    @cached_property
    def sets(self) -> list[str]:
        """Sets of bags that models were validated on."""
        names = dict.fromkeys(cost["set"] for row in self.rows for cost in row.get("costs", ()))
        return [name for name in names if name != IDENTIFICATION]

    def of_delay(self, bags: str) -> dict[float, list[Row]]:
        """Return the cells of a set by their delay [s]: a model that is known at once has no rival among later ones."""
        rows = [row for row in self.done if row["bags"] == bags]
        delays = sorted({row.get("delay", 0.0) for row in rows})
        return {delay: [row for row in rows if row.get("delay", 0.0) == delay] for delay in delays}

    def front_keys(self) -> set[str]:
        """Return the keys of the models on the front of their set of bags and delay."""
        return {row["key"] for name in self.bags for rows in self.of_delay(name).values() for row in front(rows)}

    def recommended(self) -> dict[str, Row]:
        """Return the recommended model of each set of bags, and of each delay if there are several."""
        models = {}
        for bags in self.bags:
            groups = self.of_delay(bags)
            for delay, rows in groups.items():
                name = f"{bags}, delay {1e3 * delay:g} ms" if len(groups) > 1 else bags
                models[name] = recommend_model(rows)
        return {name: row for name, row in models.items() if row is not None}
