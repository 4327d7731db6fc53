"""Fit the probabilities of `ces diagnose` to blind cases, best of a plant used for nothing else, by kind of mode.

    ces blind make --plants bouc_wen --gap-to-noise 3 --cases 110 --seed 501 --out cal
    ces blind run cal --out cal_results --jobs 2 --simulation run predictions --references 0
    ces blind run cal --out cal_results --jobs 2 --simulation run identified --references 2
    python -m bench.gaps.calibrate cal cal_results

writes ces_gap/inference/calibration.json: for each kind of mode in the results (a mode that is not there keeps its
weights) two logistic regressions (is there a gap, is its cause known) and the sharpness of the choice among effects, by
penalised maximum likelihood. Several pairs of folders are allowed.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from ces_gap.effects.library import library
from ces_gap.effects.simulation_errors import simulation_errors
from ces_gap.inference.judgement import VerdictFigures, gap_features, unknown_features
from ces_gap.limits import SearchLimits
from ces_observer.json_text import write_atomically
from ces_rig.blind.cases import open_seal
from ces_rig.blind.scoring import DECISION, GAP, Mode, find_modes

F = NDArray[np.float64]

LIMITS = {(form.name, form.limit) for form in library() if form.limit}  # a form, the effect to which it tends
PENALTY = 0.003  # of the squared weights, features scaled
FALSE_REJECTION = 0.05  # allowed share of known effects called unknown
OUT = Path(__file__).resolve().parents[2] / "ces_gap" / "inference" / "calibration.json"


@dataclass(frozen=True)
class CalibrationCase:
    """A case: its kind, the withheld effects, the features, and the gap that each effect alone leaves.

    With `error_in_gap`, the simulation's own error is a gap, too: whether there is one depends on nothing withheld.
    """

    kind: str
    plant: str
    error_in_gap: bool
    truth: frozenset[str]
    figures: VerdictFigures
    left: dict[str, float]
    composition: tuple[str, ...]


def load_cases(folder: Path, results: Path) -> dict[str, list[CalibrationCase]]:
    """Return the diagnosed cases of a blind test by class of mode, with the seal opened."""
    labels = {label.case: label for label in open_seal(folder).labels}
    cases: dict[str, list[CalibrationCase]] = {}
    for done, mode in find_modes([results], folder):
        paths = sorted(done.glob("*/decision.json"))
        known = [path.parent for path in paths if mode.references or labels[path.parent.name].baseline_ratio < 1.0]
        read = [_load_case(folder, labels[folder.name], mode) for folder in known]
        cases.setdefault(mode.class_name, []).extend(read)
    return cases


def _load_case(case: Path, label: dict[str, Any], mode: Mode) -> CalibrationCase:
    gap, decision = (json.loads((case / name).read_text(encoding="utf-8")) for name in (GAP, DECISION))
    return CalibrationCase(
        kind=label.kind,
        plant=label.plant,
        error_in_gap=mode.references == 0 and label.baseline_ratio > 0.0,
        truth=frozenset(effect.name for effect in label.effects),
        figures=VerdictFigures(**decision["figures"]),
        left=_left_by_effect(gap),
        composition=tuple(gap["composition"]["effects"]),
    )


def _left_by_effect(gap: dict[str, Any]) -> dict[str, float]:
    """Return the share of the gap that each effect alone leaves, as the diagnosis rates it.

    A map must explain more than an effect, and a form that lost to the effect to which it tends leaves clearly more.
    """
    forms = {form.name: form for form in (*library(), *simulation_errors())}
    left = {c["effect"]: 1.0 - (c["gain"] or 0.0) + forms[c["effect"]].prior_share for c in gap["causes"]}
    best = gap["composition"]["effects"]
    if len(best) == 1 and best[0] in left:
        nested = [n for n in left if (n, best[0]) in LIMITS or (best[0], n) in LIMITS]
        left.update({name: max(left[name], left[best[0]] + SearchLimits.MIN_GAIN) for name in nested})
    return left


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
            left = np.log(np.maximum([case.left[n] for n in names], 0.0) + SearchLimits.NEGLIGIBLE)
            share = np.exp(-np.exp(log_sharpness) * (left - left.min()))
            share /= share.sum()
            total -= np.log(max(float(share[[n in case.truth for n in names]].sum()), 1e-6))
        return total

    return float(np.exp(minimize_scalar(cost, bounds=(-2.0, 3.0), method="bounded").x))


def calibrate(some: list[CalibrationCase]) -> dict[str, object]:
    """Return the weights of one class of mode."""
    some = [c for c in some if not (c.kind == "none" and c.error_in_gap)]
    gap = fit_logistic(np.stack([gap_features(c.figures) for c in some]), np.array([c.kind != "none" for c in some]))
    there = [c for c in some if c.kind != "none"]
    features = np.stack([unknown_features(c.figures) for c in there])
    outside = np.array([c.kind == "outside" for c in there])
    unknown = fit_logistic(features, outside)
    known = np.sort(1.0 / (1.0 + np.exp(-(features[~outside] @ unknown))))
    threshold = float(np.clip(known[min(int((1.0 - FALSE_REJECTION) * len(known)), len(known) - 1)], 0.2, 0.7))
    return {
        "made_on": f"{len(some)} blind cases of {', '.join(sorted({c.plant for c in some}))} (bench/gaps/calibrate.py)",
        "gap": [round(float(w), 4) for w in gap],
        "unknown": [round(float(w), 4) for w in unknown],
        "sharpness": round(fit_sharpness([c for c in some if c.kind == "effect" and c.left]), 3),
        "least_gap": 0.5,
        "least_known": round(1.0 - threshold, 3),
    }


def main() -> None:
    calibration = json.loads(OUT.read_text(encoding="utf-8"))
    cases: dict[str, list[CalibrationCase]] = {}
    for folder, results in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        for name, read in load_cases(Path(folder), Path(results)).items():
            cases.setdefault(name, []).extend(read)
    calibration |= {name: calibrate(read) for name, read in cases.items()}
    write_atomically(OUT, json.dumps(calibration, indent=1) + "\n")
    print(json.dumps({name: calibration[name] for name in cases}, indent=1))


if __name__ == "__main__":
    main()
