"""The files of a learned stroke: `command.csv`, `learned.yaml`, `result.json` and `report.html`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ces_iterate.stroke.goal import LearnedStroke, command_peaks
from ces_iterate.stroke.page import error_above_bandwidth, find_warnings, stroke_page
from ces_iterate.stroke.plan import StrokePlan, write_learned_experiment
from ces_observer.json_checks import write_all_atomically

SCHEMA = "ces-learned-stroke/1"
COMMAND, EXPERIMENT, RESULT, REPORT = "command.csv", "learned.yaml", "result.json", "report.html"


def write_results(folder: Path, plan: StrokePlan, learned: LearnedStroke, facts: Mapping[str, str]) -> None:
    """Write all four files into `folder`, or none; raises CesError if they cannot be written."""
    write_all_atomically(
        {
            folder / COMMAND: format_command(learned),
            folder / EXPERIMENT: write_learned_experiment(plan, COMMAND),
            folder / RESULT: json.dumps(as_json(learned), indent=1) + "\n",
            folder / REPORT: stroke_page(learned, f"Learned stroke {plan.experiment.settings.name}", facts),
        }
    )


def format_command(learned: LearnedStroke) -> str:
    """Return the learned command as CSV, columns `time_s` and `position_m`."""
    interval = learned.goal.interval_s
    rows = (f"{n * interval:.4f},{value:.9f}" for n, value in enumerate(learned.learned.command_m))
    return "\n".join(["time_s,position_m", *rows]) + "\n"


def as_json(learned: LearnedStroke) -> dict[str, Any]:
    """Return the outcome as plain JSON values; lengths in metres."""
    f = learned.learning_filter
    return {
        "schema": SCHEMA,
        "stopped": learned.stopped,
        "iterations": learned.iterations,
        "repeatability_m": learned.repeatability_m,
        "first_error_m": learned.first.error_m,
        "confirmed_error_m": learned.confirmation.error_m,
        "error_above_bandwidth_m": error_above_bandwidth(learned),
        "best_run": learned.best + 1,
        "runs": [
            {"kind": run.kind, "error_m": run.error_m, "gain": run.scale, "limited": run.limited}
            for run in learned.runs
        ],
        "filter": {
            "bandwidth_Hz": f.bandwidth_Hz,
            "model_tolerance": f.tolerance,
            "max_contraction": float(f.contraction.max()),
            "max_contraction_of_exact_model": float(f.nominal.max()),
            "response_measured": learned.measured is not None,
        },
        "model": f.model.as_dict(),
        "limits": {
            name: {"wanted": wanted, "highest": highest, "limit": limit}
            for name, wanted, highest, limit in command_peaks(learned)
        },
        "warnings": list(find_warnings(learned)),
    }
