"""How far a gap truly shrank on the fresh recording, and where it truly lay: noise-free arrays from the seal.

    closure = 1 − rms(true − augmented) / rms(true − simulation)
    oracle  = 1 − rms(true − (corrected + true effect)) / rms(true − simulation)

`corrected` is the simulation with what references taught: the oracle knows the effect exactly, and the simulation's
error as well as the diagnosis did. An oracle without that correction (`plain_oracle`) knows the effect alone; one that
knew both would close everything. Forces [N] at the position samples, without either end of the recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

F = NDArray[np.float64]
Arrays = Mapping[str, F]

EDGE = 0.03  # share of the samples at either end where filters run in
AXES = {"direction": "speed_m_s", "speed_m_s": "speed_m_s"}  # axes of `where` that are judged, by sealed array


def closure(truth: Arrays, replay: Arrays, name: str) -> dict[str, float]:
    """Return the true figures of the recording `name`; empty if the replay does not fit its samples."""
    force, effect, simulated = (truth[f"{name}_{key}"] for key in ("force_N", "effect_N", "baseline_N"))
    augmented, corrected = replay[f"{name}_augmented_N"], replay[f"{name}_corrected_N"]
    if not len(augmented) == len(corrected) == len(force):
        return {}
    kept = _inner_mask(len(force)) & np.isfinite(simulated) & np.isfinite(augmented)

    def remaining_rms(of: F) -> float:
        return float(np.sqrt(np.mean((force - of)[kept] ** 2)))

    before = remaining_rms(simulated)
    shrink = {
        "closure": 1.0 - remaining_rms(augmented) / before,
        "oracle": 1.0 - remaining_rms(corrected + effect) / before,
        "plain_oracle": 1.0 - remaining_rms(simulated + effect) / before,
    }
    return {**shrink, "gap_N": before, "relative": shrink["closure"] / max(shrink["oracle"], 1e-3)}


def where_error(
    truth: Arrays, regions: Sequence[Mapping[str, Any]], names: Sequence[str], corrected: bool
) -> dict[str, float]:
    """Return by axis the total-variation distance between the shares of energy that were said and the true ones.

    With `corrected`, references took the simulation's own error out of the gap: the effect is what is located.
    """
    out = {}
    for axis, key in AXES.items():
        mine = [region for region in regions if region["axis"] == axis]
        values = np.concatenate([truth[f"{name}_{key}"] for name in names])
        gap = np.concatenate([_gap(truth, name, corrected) for name in names])
        if mine:
            out[f"where_{axis}"] = _distance(mine, np.sign(values) if axis == "direction" else values, gap)
    return out


def _gap(truth: Arrays, name: str, corrected: bool) -> F:
    return truth[f"{name}_effect_N"] if corrected else truth[f"{name}_force_N"] - truth[f"{name}_baseline_N"]


def _distance(regions: Sequence[Mapping[str, Any]], values: F, gap: F) -> float:
    known = np.isfinite(gap) & _inner_mask(len(gap))
    energy = np.where(known, np.nan_to_num(gap) ** 2, 0.0)
    total = max(float(energy.sum()), 1e-12)
    said = [max(float(region["share_of_energy"] or 0.0), 0.0) for region in regions]
    true = [float(energy[_inside(region, values)].sum()) / total for region in regions]
    rest = abs(max(1.0 - sum(said), 0.0) - max(1.0 - sum(true), 0.0))
    return 0.5 * (sum(abs(a - b) for a, b in zip(said, true, strict=True)) + rest)


def _inside(region: Mapping[str, Any], values: F) -> NDArray[np.bool_]:
    low = -np.inf if region["from"] is None else region["from"]
    high = np.inf if region["to"] is None else region["to"]
    return np.asarray((values >= low) & (values < high) if high < values.max() else (values >= low))


def _inner_mask(count: int) -> NDArray[np.bool_]:
    edge = round(EDGE * count)
    kept = np.zeros(count, bool)
    kept[edge : count - edge] = True
    return kept
