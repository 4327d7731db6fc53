"""Compares diagnoses with the sealed answers: folders of results and cases go in, one outcome for each case comes out.

The diagnosis is read from its files: `row.json` (status and seconds), `gap.json`, `decision.json` and `replay.npz`. How
far a gap truly shrank on the held-out recording, and where it truly was, follows from the sealed noise-free arrays:

    closure = 1 − rms(true − augmented) / rms(true − simulation)
    oracle  = 1 − rms(true − (corrected + true effect)) / rms(true − simulation)

`corrected` is the simulation with the correction from references: the oracle knows the effect exactly, but the
simulation's error only as well as the diagnosis. Without that correction, `plain_oracle` knows the effect alone; it
leaves `error_N`, the simulation's own error. Forces [N] are at the position samples, without both ends of the
recording.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ces_data.arrays import F, Mask
from ces_observer.errors import CesError
from ces_rig.blind.cases import open_arrays, read_seal
from ces_rig.blind.draw import HELD_OUT, REAL
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
AXES = {"direction": "speed_m_s", "speed_m_s": "speed_m_s"}  # scored axes of `where`: name of the sealed array


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
            outcomes.append(build_case_outcome(label, FAILED_DIAGNOSIS, {}, {}, row["seconds"], mode))
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
    figures |= where_error(truth, gap["where"], (*REAL, *HELD_OUT), corrected=mode.references > 0)
    return build_case_outcome(label, gap, figures, _json(results / DECISION)["baselines"], seconds, mode)


def _json(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise CesError(f"{path}: cannot be read ({error}); expected the output of 'ces blind run'") from None


def closure(truth: Arrays, replay: Arrays, name: str) -> dict[str, float]:
    """Return the true figures of the recording `name`; empty if the replay has another number of samples."""
    force, effect = (truth[f"{name}_{key}"] for key in ("force_N", "effect_N"))
    simulated, augmented, corrected = (replay[f"{name}_{key}_N"] for key in ("simulated", "augmented", "corrected"))
    if not len(simulated) == len(augmented) == len(corrected) == len(force):
        return {}
    mask = _inner_mask(len(force)) & np.isfinite(simulated) & np.isfinite(augmented)

    def remaining_rms(estimate: F) -> float:
        return float(np.sqrt(np.mean((force - estimate)[mask] ** 2)))

    before, error = remaining_rms(simulated), remaining_rms(simulated + effect)
    shrink = {
        "closure": 1.0 - remaining_rms(augmented) / before,
        "oracle": 1.0 - remaining_rms(corrected + effect) / before,
        "plain_oracle": 1.0 - error / before,
    }
    return {**shrink, "gap_N": before, "error_N": error, "relative": shrink["closure"] / max(shrink["oracle"], 1e-3)}


def where_error(
    truth: Arrays, regions: Sequence[Mapping[str, Any]], names: Sequence[str], corrected: bool
) -> dict[str, float]:
    """Return by axis the total-variation distance between the reported shares of energy and the true ones.

    With `corrected`, references removed the simulation's own error from the gap, so that only the effect is located.
    """
    effects = [truth[f"{name}_effect_N"] for name in names]
    gap = np.concatenate(
        effects if corrected else [truth[f"{name}_force_N"] - truth[f"{name}_baseline_N"] for name in names]
    )
    energy = np.where(np.isfinite(gap) & _inner_mask(len(gap)), np.nan_to_num(gap) ** 2, 0.0)
    distances = {}
    for axis, key in AXES.items():
        values = np.concatenate([truth[f"{name}_{key}"] for name in names])
        reported = [region for region in regions if region["axis"] == axis]
        if reported:
            distances[f"where_{axis}"] = _distance(reported, np.sign(values) if axis == "direction" else values, energy)
    return distances


def _distance(regions: Sequence[Mapping[str, Any]], values: F, energy: F) -> float:
    """Return the total-variation distance between claimed and true shares of the regions, and of what is left."""
    total = max(float(energy.sum()), 1e-12)
    claimed, true = [], []
    for region in regions:
        low = -np.inf if region["from"] is None else region["from"]
        high = np.inf if region["to"] is None else region["to"]
        inside = (values >= low) & (values < high) if high < values.max() else values >= low
        claimed.append(max(float(region["share_of_energy"] or 0.0), 0.0))
        true.append(float(energy[inside].sum()) / total)
    rest = abs(max(1.0 - sum(claimed), 0.0) - max(1.0 - sum(true), 0.0))
    return 0.5 * (sum(abs(a - b) for a, b in zip(claimed, true, strict=True)) + rest)


def _inner_mask(count: int) -> Mask:
    """Return which samples are not at the ends, (count,)."""
    edge, index = round(EDGE * count), np.arange(count)
    return (index >= edge) & (index < count - edge)
