"""Compares diagnoses with the sealed answers: folders of results and cases go in, one outcome for each case comes out.

The diagnosis is read from its files: `row.json` (status and seconds), `gap.json` and `replay.npz`. How far a gap truly
shrank on the held-out recording follows from the sealed noise-free arrays:

    closure = 1 − rms(true − augmented) / rms(true − simulation)

Forces [N] are at the position samples, without both ends of the recording.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ces_data.arrays import F
from ces_observer.errors import CesError
from ces_rig.blind.cases import open_arrays, read_seal
from ces_rig.blind.draw import HELD_OUT
from ces_rig.blind.outcome import CaseOutcome, Mode, build_case_outcome

Arrays = Mapping[str, F]

SETTINGS = "run.json"  # in the folder of a mode
ROW, GAP, REPLAY, DECISION = "row.json", "gap.json", "replay.npz", "decision.json"  # in that of a case
FAILED_DIAGNOSIS: Mapping[str, Any] = {
    "verdict": "failed",
    "causes": [],
    "composition": {"effects": [], "shrink": None},
    "probabilities": {"none": 0.0, "unknown": 0.0},
    "indistinguishable": [],
}  # in place of the gap.json of a failed diagnosis
EDGE = 0.03  # share of the samples at each end where filters settle


def find_modes(results: Sequence[Path], cases: Path) -> Iterator[tuple[Path, Mode]]:
    """Yield each folder of results with its mode; raises CesError if there is none, or if it is of other cases."""
    for given in results:
        folders = [given] if (given / SETTINGS).is_file() else sorted(p.parent for p in given.glob(f"*/{SETTINGS}"))
        if not folders:
            raise CesError(f"{given}: contains no {SETTINGS}; expected the output of 'ces blind run'")
        for folder in folders:
            settings = _json(folder / SETTINGS)
            if settings.get("seal") not in ("", read_seal(cases)):
                raise CesError(f"{folder}: holds results of other cases than {cases}")
            if "references" not in settings:
                raise CesError(f"{folder}: holds results of an older version; run 'ces blind run' again")
            yield folder, Mode(settings["simulation"], settings["references"])


def score_cases(
    cases: Path, results: Path, labels: Iterable[dict[str, Any]], mode: Mode
) -> tuple[list[CaseOutcome], dict[str, str]]:
    """Return the outcomes of the diagnosed cases, and the reasons of failures, which count as wrong."""
    outcomes, failed = [], {}
    for label in labels:
        case_results = results / label["case"]
        if not (case_results / ROW).is_file():
            continue
        row = _json(case_results / ROW)
        if row["status"] == "done":
            outcomes.append(_score_case(cases, case_results, label, row["seconds"], mode))
        else:
            outcomes.append(build_case_outcome(label, FAILED_DIAGNOSIS, {"closure": 0.0}, row["seconds"], mode))
            failed[label["case"]] = row["reason"]
    return outcomes, failed


def _score_case(cases: Path, results: Path, label: dict[str, Any], seconds: float, mode: Mode) -> CaseOutcome:
    gap, truth = _json(results / GAP), open_arrays(cases, label)
    with np.load(results / REPLAY, allow_pickle=False) as arrays:
        replay = {name: arrays[name].astype(np.float64) for name in arrays.files}
    figures = closure(truth, replay, HELD_OUT[0])
    claimed = gap["composition"]["shrink"]
    if figures and claimed is not None:
        figures["shrink_error"] = abs(claimed - figures["closure"])
    return build_case_outcome(label, gap, figures, seconds, mode)


def _json(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise CesError(f"{path}: cannot be read ({error}); expected the output of 'ces blind run'") from None


def closure(truth: Arrays, replay: Arrays, name: str) -> dict[str, float]:
    """Return the true figures of the recording `name`; empty if the replay has another number of samples.

    Effects shrink what the correction from references leaves.
    """
    force, augmented = truth[f"{name}_force_N"], replay[f"{name}_augmented_N"]
    corrected = replay.get(f"{name}_corrected_N", replay[f"{name}_simulated_N"])  # older results have none
    if not len(corrected) == len(augmented) == len(force):
        return {}
    edge, index = round(EDGE * len(force)), np.arange(len(force))
    mask = np.isfinite(corrected + augmented) & (index >= edge) & (index < len(force) - edge)
    gap, left = (float(np.sqrt(np.mean((force - estimate)[mask] ** 2))) for estimate in (corrected, augmented))
    return {"closure": 1.0 - left / gap}
