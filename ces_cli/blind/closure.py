"""How far a gap truly shrank on the held-out recording, and where it truly was, from the sealed noise-free arrays.

    closure = 1 − rms(true − augmented) / rms(true − simulation)
    oracle  = 1 − rms(true − (corrected + true effect)) / rms(true − simulation)

`corrected` is the simulation with the correction from references: the oracle knows the effect exactly, but the
simulation's error only as well as the diagnosis. Without that correction, `plain_oracle` knows the effect alone; it
leaves `error_N`, the simulation's own error. Forces [N] are at the position samples, without both ends of the
recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

F = NDArray[np.float64]
Arrays = Mapping[str, F]

EDGE = 0.03  # share of the samples at each end where filters settle
AXES = {"direction": "speed_m_s", "speed_m_s": "speed_m_s"}  # scored axes of `where`: name of the sealed array


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
    distances = {}
    for axis, key in AXES.items():
        reported = [region for region in regions if region["axis"] == axis]
        values = np.concatenate([truth[f"{name}_{key}"] for name in names])
        gap = np.concatenate([_gap(truth, name, corrected) for name in names])
        if reported:
            distances[f"where_{axis}"] = _distance(reported, np.sign(values) if axis == "direction" else values, gap)
    return distances


def _gap(truth: Arrays, name: str, corrected: bool) -> F:
    return truth[f"{name}_effect_N"] if corrected else truth[f"{name}_force_N"] - truth[f"{name}_baseline_N"]


def _distance(regions: Sequence[Mapping[str, Any]], values: F, gap: F) -> float:
    known = np.isfinite(gap) & _inner_mask(len(gap))
    energy = np.where(known, np.nan_to_num(gap) ** 2, 0.0)
    total = max(float(energy.sum()), 1e-12)
    claimed = [max(float(region["share_of_energy"] or 0.0), 0.0) for region in regions]
    true = [float(energy[_inside(region, values)].sum()) / total for region in regions]
    rest = abs(max(1.0 - sum(claimed), 0.0) - max(1.0 - sum(true), 0.0))
    return 0.5 * (sum(abs(a - b) for a, b in zip(claimed, true, strict=True)) + rest)


def _inside(region: Mapping[str, Any], values: F) -> NDArray[np.bool_]:
    low = -np.inf if region["from"] is None else region["from"]
    high = np.inf if region["to"] is None else region["to"]
    return np.asarray((values >= low) & (values < high) if high < values.max() else (values >= low))


def _inner_mask(count: int) -> NDArray[np.bool_]:
    edge = round(EDGE * count)
    index = np.arange(count)
    return (index >= edge) & (index < count - edge)
