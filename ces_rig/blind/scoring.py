"""Compares diagnoses with the sealed answers: folders of results and cases go in, one outcome for each case comes out.

An outcome holds the withheld effects and what the diagnosis said; all metrics are computed from outcomes. A `Mode` is
how the blind test uses the diagnosis: what stands for the simulation, and how many references it gets.

The diagnosis is read from its files: `row.json` (status and seconds), `gap.json` and `replay.npz`. How far a gap truly
shrank on the held-out recording follows from the sealed noise-free arrays:

    closure = 1 − rms(true − augmented) / rms(true − simulation)

Forces [N] are at the position samples, without both ends of the recording.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ces_data.arrays import F
from ces_observer.errors import CesError, OptionName
from ces_rig.blind.cases import CaseLabel, open_arrays, read_seal
from ces_rig.blind.plan import HELD_OUT

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


RUN, PREDICTIONS, IDENTIFIED = "run", "predictions", "identified"
SIMULATIONS = (RUN, PREDICTIONS, IDENTIFIED)
MAX_REFERENCES = 5  # a case holds no more
CLASSES = ("references", "no_references", "predictions", "identified")
"""Kinds of mode with their own targets and probabilities; the first two run the simulation."""


@dataclass(frozen=True)
class Mode:
    """`simulation` is RUN, PREDICTIONS or IDENTIFIED (a model identified from the references); raises CesError."""

    simulation: str = RUN
    references: int = 2

    def __post_init__(self) -> None:
        if self.simulation not in SIMULATIONS:
            expected = f": expected one of {', '.join(SIMULATIONS)}"
            raise CesError(OptionName("simulation", self.simulation), expected)
        if not 0 <= self.references <= MAX_REFERENCES:
            raise CesError(OptionName("references", self.references), f": expected 0 to {MAX_REFERENCES}")
        if self.simulation == IDENTIFIED and self.references == 0:
            needs = ": a model is identified from references; add "
            raise CesError(OptionName("simulation", IDENTIFIED), needs, OptionName("references", 5))

    @property
    def name(self) -> str:
        """The name of the mode's folder of results, such as `run_2`."""
        return f"{self.simulation}_{self.references}"

    @property
    def class_name(self) -> str:
        """The one of CLASSES whose targets apply."""
        if self.simulation != RUN:
            return self.simulation
        return "references" if self.references else "no_references"


def combine_modes(simulations: Sequence[str], references: Sequence[int]) -> list[Mode]:
    """Return the possible modes of both lists, none identified without references; raises CesError if none is."""
    pairs = list(dict.fromkeys(product(simulations, references)))
    possible = [pair for pair in pairs if pair != (IDENTIFIED, 0)]
    return [Mode(*pair) for pair in possible or pairs]


NONE, UNKNOWN = "none", "unknown"  # candidates besides the effects
CALIBRATION = "calibration"  # the cause "the simulation's force map is off"
SAME = ("case", "kind", "plant", "excitation", "gap_to_noise", "baseline_ratio")  # in a label


@dataclass(frozen=True)
class CaseOutcome:
    """A case: its sealed description, its diagnosis (`gap.json`) and the true figures from the sealed arrays.

    `ranked` are the causes, most probable first; `probability` is by candidate, with `none` and `unknown`;
    `composition` names the effects; `indistinguishable` are groups that the diagnosis reported.
    """

    case: str
    kind: str
    truth: tuple[str, ...]
    gap_to_noise: float
    baseline_ratio: float
    excitation: str
    plant: str
    verdict: str
    ranked: tuple[str, ...]
    probability: Mapping[str, float]
    composition: tuple[str, ...]
    indistinguishable: tuple[frozenset[str], ...]
    figures: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    mode: Mode = field(default_factory=Mode)

    @property
    def is_simulation_wrong(self) -> bool:
        """Whether the simulation has an error of its own, as an identified model always has."""
        return self.baseline_ratio > 0.0 or self.mode.simulation == IDENTIFIED

    @property
    def is_error_in_gap(self) -> bool:
        """Whether that error is a part of the gap, because there are no references that show it."""
        return self.is_simulation_wrong and self.mode.references == 0

    @property
    def answer(self) -> str:
        """The right candidate: an effect's name, `none` or `unknown`; for a pair both names."""
        return {NONE: NONE, "outside": UNKNOWN}.get(self.kind, " + ".join(self.truth))

    @property
    def accepted(self) -> frozenset[str]:
        """The candidates that are right; several if nothing is withheld but the simulation's error is in the gap."""
        if self.kind == NONE and self.is_error_in_gap:
            return frozenset({NONE, UNKNOWN, CALIBRATION})
        return frozenset({self.answer})

    @property
    def found(self) -> tuple[str, ...]:
        """The composition without `calibration` where that is true, too, beside a withheld effect."""
        extra = {CALIBRATION} if self.is_simulation_wrong and set(self.truth) & set(self.composition) else set()
        return tuple(name for name in self.composition if name not in extra)

    def is_in_top(self, count: int) -> bool:
        """Return whether a withheld effect is among the first `count` causes."""
        return bool(set(self.truth) & set(self.ranked[:count]))

    def is_named_wrongly(self) -> bool:
        """Return whether the verdict is `named` with an effect that was not withheld."""
        return self.verdict == "named" and not set(self.found) <= set(self.truth)

    def is_false_alarm(self) -> bool:
        """Return whether a cause is claimed although nothing was withheld.

        Where the simulation's own error is in the gap, `unknown` and `calibration` alone are right, too.
        """
        if self.is_error_in_gap:
            return self.verdict not in ("no_gap", UNKNOWN) and self.composition != (CALIBRATION,)
        return self.verdict != "no_gap"

    def is_first_by_class(self) -> bool:
        """Return whether the first cause is a withheld effect or was reported as indistinguishable from it."""
        return bool(self.ranked) and any(self.is_same_class(self.ranked[0], name) for name in self.truth)

    def is_same_class(self, a: str, b: str) -> bool:
        """Return whether two names are equal or in one group."""
        return a == b or any({a, b} <= group for group in self.indistinguishable)

    def finds_exactly(self) -> bool:
        """Return whether the composition is exactly the withheld effects."""
        return sorted(self.found) == sorted(self.truth)


def build_case_outcome(
    label: CaseLabel, gap: Mapping[str, Any], figures: Mapping[str, float], seconds: float, mode: Mode
) -> CaseOutcome:
    """Return the record of a case from its label and its `gap.json`."""
    causes, rest, together = gap["causes"], gap["probabilities"], gap["composition"]
    shares = {c["effect"]: c["probability"] for c in causes}
    members = [name for name in together["effects"] if name in shares]
    shares |= dict.fromkeys(members, together["probability"] / max(len(members), 1))  # that they sum to 1
    return CaseOutcome(
        **{key: getattr(label, key) for key in SAME},
        truth=tuple(effect.name for effect in label.effects),
        verdict=gap["verdict"],
        ranked=tuple(cause["effect"] for cause in causes),
        probability={**shares, NONE: rest["none"], UNKNOWN: rest["unknown"]},
        composition=tuple(together["effects"]),
        indistinguishable=tuple(frozenset(group) for group in gap["indistinguishable"]),
        figures=figures,
        seconds=seconds,
        mode=mode,
    )


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
    cases: Path, results: Path, labels: Iterable[CaseLabel], mode: Mode
) -> tuple[list[CaseOutcome], dict[str, str]]:
    """Return the outcomes of the diagnosed cases, and the reasons of failures, which count as wrong."""
    outcomes, failed = [], {}
    for label in labels:
        case_results = results / label.case
        if not (case_results / ROW).is_file():
            continue
        row = _json(case_results / ROW)
        if row["status"] == "done":
            outcomes.append(_score_case(cases, case_results, label, row["seconds"], mode))
        else:
            outcomes.append(build_case_outcome(label, FAILED_DIAGNOSIS, {"closure": 0.0}, row["seconds"], mode))
            failed[label.case] = row["reason"]
    return outcomes, failed


def _score_case(cases: Path, results: Path, label: CaseLabel, seconds: float, mode: Mode) -> CaseOutcome:
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
