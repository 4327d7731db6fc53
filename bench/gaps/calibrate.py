"""Fit the probabilities of `ces diagnose` to blind cases of a plant that is used for nothing else.

    ces blind make --plants calibration --grid small --cases 110 --seed 501 --out cal
    ces blind run cal --out cal_results
    python -m bench.gaps.calibrate cal cal_results

writes ces_gap/inference/calibration.json: two logistic regressions (is there a gap, is its cause known) and the
sharpness of the choice among effects, by penalised maximum likelihood. Several pairs of folders are allowed.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from ces_gap.inference.verdict import NEGLIGIBLE_SHARE, VerdictFigures, gap_features, unknown_features
from ces_observer.json_checks import write_atomically
from ces_rig.blind.seal import open_seal

F = NDArray[np.float64]

PENALTY = 0.0003  # of the squared weights, features scaled
FALSE_REJECTION = 0.05  # allowed share of known effects called unknown
OUT = Path(__file__).resolve().parents[2] / "ces_gap" / "inference" / "calibration.json"


@dataclass(frozen=True)
class CalibrationCase:
    """A case: its kind, the withheld effects, the features, and the gap that each effect alone leaves."""

    kind: str
    truth: frozenset[str]
    figures: VerdictFigures
    left: dict[str, float]
    composition: tuple[str, ...]


def load_cases(folder: Path, results: Path) -> list[CalibrationCase]:
    """Return the diagnosed cases of a blind test, with the seal opened."""
    labels = {label["case"]: label for label in open_seal(folder)[1]}
    cases = []
    for path in sorted(results.glob("*/decision.json")):
        label, gap = labels[path.parent.name], json.loads((path.parent / "gap.json").read_text(encoding="utf-8"))
        figures = VerdictFigures(**json.loads(path.read_text(encoding="utf-8"))["figures"])
        left = {cause["effect"]: 1.0 - (cause["gain"] or 0.0) for cause in gap["causes"]}
        truth = frozenset(effect["name"] for effect in label["effects"])
        cases.append(CalibrationCase(label["kind"], truth, figures, left, tuple(gap["composition"]["effects"])))
    return cases


def fit_logistic(features: F, positive: NDArray[np.bool_]) -> F:
    """Return the weights (q,) of a penalised logistic regression on features (n, q), the first of them 1.

    All weights but the first are at least 0, so that a feature cannot count against its own class.
    """
    spread = np.maximum(features.std(axis=0), 1e-9)
    spread[0] = 1.0
    scaled, sign = features / spread, np.where(positive, 1.0, -1.0)

    def cost(w: F) -> float:
        return float(np.logaddexp(0.0, -sign * (scaled @ w)).mean() + PENALTY * (w[1:] @ w[1:]))

    bounds = [(None, None), *((0.0, None) for _ in spread[1:])]
    return np.asarray(minimize(cost, np.zeros(features.shape[1]), bounds=bounds).x / spread)


def fit_sharpness(some: list[CalibrationCase]) -> float:
    """Return the maximum-likelihood sharpness of the choice among effects."""

    def cost(log_sharpness: float) -> float:
        total = 0.0
        for case in some:
            names = list(case.left)
            left = np.log(np.maximum([case.left[n] for n in names], 0.0) + NEGLIGIBLE_SHARE)
            share = np.exp(-np.exp(log_sharpness) * (left - left.min()))
            share /= share.sum()
            total -= np.log(max(float(share[[n in case.truth for n in names]].sum()), 1e-6))
        return total

    return float(np.exp(minimize_scalar(cost, bounds=(-2.0, 3.0), method="bounded").x))


def calibrate(some: list[CalibrationCase]) -> dict[str, object]:
    """Return the contents of calibration.json."""
    gap = fit_logistic(np.stack([gap_features(c.figures) for c in some]), np.array([c.kind != "none" for c in some]))
    there = [c for c in some if c.kind != "none"]
    features = np.stack([unknown_features(c.figures) for c in there])
    outside = np.array([c.kind == "outside" for c in there])
    unknown = fit_logistic(features, outside)
    known = np.sort(1.0 / (1.0 + np.exp(-(features[~outside] @ unknown))))
    threshold = float(np.clip(known[min(int((1.0 - FALSE_REJECTION) * len(known)), len(known) - 1)], 0.2, 0.7))
    return {
        "made_on": f"{len(some)} blind cases of the plant 'calibration' (bench/gaps/calibrate.py)",
        "gap": [round(float(w), 4) for w in gap],
        "unknown": [round(float(w), 4) for w in unknown],
        "sharpness": round(fit_sharpness([c for c in some if c.kind == "effect" and c.left]), 3),
        "least_gap": 0.5,
        "least_known": round(1.0 - threshold, 3),
    }


def main() -> None:
    pairs = list(zip(sys.argv[1::2], sys.argv[2::2], strict=True))
    calibration = calibrate([case for a, b in pairs for case in load_cases(Path(a), Path(b))])
    write_atomically(OUT, json.dumps(calibration, indent=1) + "\n")
    print(json.dumps(calibration, indent=1))


if __name__ == "__main__":
    main()
