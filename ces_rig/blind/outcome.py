"""The outcome of one blind case: the withheld effects and what the diagnosis said, from which all metrics are computed.

A `Mode` is how the blind test uses the diagnosis: what stands for the simulation, and how many reference recordings it
gets. `COUNTERPARTS` says which parameters of the library can be compared with the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations, product
from typing import Any

from ces_observer.errors import CesError
from ces_rig.dampers.kinds import KINDS

RUN, PREDICTIONS, IDENTIFIED = "run", "predictions", "identified"
SIMULATIONS = (RUN, PREDICTIONS, IDENTIFIED)
MAX_REFERENCES = 2  # a case holds no more
TEXT = {
    RUN: "simulation run by the diagnosis",
    PREDICTIONS: "simulation known from recorded predictions only",
    IDENTIFIED: "model identified from the references as simulation",
}
CLASSES = ("references", "no_references", "predictions", "identified")
"""Kinds of mode with their own targets and probabilities; the first two run the simulation."""
COUNTS = ("no references", "one reference", "two references")


@dataclass(frozen=True)
class Mode:
    """`simulation` is RUN, PREDICTIONS or IDENTIFIED (a model identified from the references); raises CesError."""

    simulation: str = RUN
    references: int = MAX_REFERENCES

    def __post_init__(self) -> None:
        if self.simulation not in SIMULATIONS:
            raise CesError(f"--simulation '{self.simulation}': expected one of {', '.join(SIMULATIONS)}")
        if not 0 <= self.references <= MAX_REFERENCES:
            raise CesError(f"--references {self.references}: expected 0 to {MAX_REFERENCES}")
        if self.simulation == IDENTIFIED and self.references == 0:
            raise CesError("--simulation identified: a model is identified from references; add --references 1 or 2")

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

    @property
    def text(self) -> str:
        """The mode in words."""
        return f"{TEXT[self.simulation]}, {COUNTS[self.references]}"


def combine_modes(simulations: Sequence[str], references: Sequence[int]) -> list[Mode]:
    """Return the possible modes of both lists, none identified without references; raises CesError if none is."""
    pairs = list(dict.fromkeys(product(simulations, references)))
    possible = [pair for pair in pairs if pair != (IDENTIFIED, 0)]
    return [Mode(*pair) for pair in possible or pairs]


Numbers = Mapping[str, float]
Counterpart = Callable[[Numbers, Numbers, str], float | None]
"""(true numbers of the effect by path, reported values by parameter, kind of plant) -> true value, None if none."""

MAX_LAG_SHARE = 0.05  # of a late position: with more, the sensor's filter is no shift any more


def list_coverage(label: Mapping[str, Any], gap: Mapping[str, Any]) -> tuple[bool, ...]:
    """Return for each comparable parameter of the withheld effects that were found whether its interval contains it."""
    reported = gap["composition"].get("parameters", {})
    hits = []
    for effect in label["effects"]:
        parameters = reported.get(effect["name"], {})
        values = {name: parameter["value"] for name, parameter in parameters.items()}
        for name, parameter in parameters.items():
            find = COUNTERPARTS.get((effect["name"], name))
            true = None if find is None else find(effect["physical"], values, label["plant"])
            if true is not None and None not in parameter["ci95"]:
                low, high = parameter["ci95"]
                hits.append(low <= true <= high)
    return tuple(hits)


def _read(true: Numbers, *paths: str, sign: float = 1.0) -> float | None:
    """Return the number at the first of the paths that the effect has."""
    return next((sign * true[path] for path in paths if path in true), None)


def _find_increase(true: Numbers, plant: str, *paths: str) -> float | None:
    """Return how much the effect adds to the number of the plant's design, which does not vary between plants."""
    path = next((path for path in paths if path in true), None)
    return None if path is None else true[path] - KINDS[plant].design.number(path)


def _added_stiffness(true: Numbers, values: Numbers, plant: str) -> float | None:
    """Return the stiffness that the effect puts in series, unless the bushing relaxes or stiffens."""
    path = next((path for path in ("mount.stiffness_N_m", "mount_N_m") if path in true), None)
    if path is None or len(true) != len(("stiffness", "damping")) or "knee_N" in values:
        return None
    return 1.0 / (1.0 / true[path] - 1.0 / KINDS[plant].design.number(path))


CLEARANCE = ("body.bump_clearance_m", "stop_clearance_m")
COUNTERPARTS: Mapping[tuple[str, str], Counterpart] = {
    ("force_offset", "offset_N"): lambda t, v, p: _read(t, "offset_N"),
    ("current_scale", "gain"): lambda t, v, p: 1.0 / (1.0 + t["gain"]) if "offset_A" in v else None,
    ("current_scale", "offset_A"): lambda t, v, p: -t["offset_A"] / (1.0 + t["gain"]),
    # minus the delay of the logged position; a late one is also filtered
    ("position_delay", "delay_s"): lambda t, v, p: (
        -t["delay_s"] if t["delay_s"] < 0.0 or t["lag_share"] <= MAX_LAG_SHARE else None
    ),
    ("inertia", "mass_kg"): lambda t, v, p: _find_increase(t, p, "body.moving_mass_kg", "mass_kg"),
    ("backlash", "gap_m"): lambda t, v, p: _find_increase(t, p, "mount.play_m", "play_m"),
    ("mount_compliance", "stiffness_N_m"): _added_stiffness,
    ("bump_stop", "compression_m"): lambda t, v, p: _read(t, *CLEARANCE),
    ("bump_stop", "rebound_m"): lambda t, v, p: (
        None if _read(t, *CLEARANCE) is None else -(_read(t, *CLEARANCE) or 0.0)
    ),
    ("bump_stop", "stiffness_N_m"): lambda t, v, p: _read(t, "body.bump_stiffness_N_m", "stop_N_m"),
    ("friction", "coulomb_N"): lambda t, v, p: _find_increase(t, p, "seal_N"),
    ("leakage", "leak_m_sN"): lambda t, v, p: _find_increase(t, p, "bypass_m_Ns"),
    # the half width of the magnetic loop, if the law is that of the form (plays, or remanence)
    ("current_hysteresis", "hysteresis_A"): lambda t, v, p: _find_increase(
        t, p, "remanence_A" if "travel_A" in v else "ces_valve.hysteresis_A"
    ),
    ("current_hysteresis", "travel_A"): lambda t, v, p: _read(t, "remanence_bend_A"),
}
"""The true value of a parameter of the library, from the physical numbers of the sealed label. Most effects of the rig
have no such number: they follow other laws than the forms."""
NONE, UNKNOWN = "none", "unknown"  # candidates besides the effects
CALIBRATION = "calibration"  # the cause "the simulation's force map is off"
SAME = ("case", "kind", "plant", "excitation", "gap_to_noise", "baseline_ratio", "gap_N")  # in a label
SURE_PROBABILITY = 0.9  # from here on a wrong cause counts as confidently wrong


@dataclass(frozen=True)
class CaseOutcome:
    """A case: its sealed description, its diagnosis (`gap.json`) and the true figures from the sealed arrays.

    `ranked` are the causes, most probable first; `probability` is by candidate, with `none` and `unknown`;
    `composition` names the effects; `indistinguishable` are groups that the diagnosis reported; `covered` says for each
    comparable parameter whether its interval contains the truth.
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
    baselines: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    mode: Mode = field(default_factory=Mode)
    gap_N: float = 0.0
    covered: tuple[bool, ...] = ()

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

    def is_first_effect(self) -> bool:
        """Return whether a withheld effect comes first, `calibration` left out where the simulation is wrong."""
        ranked = [name for name in self.ranked if not (name == CALIBRATION and self.is_simulation_wrong)]
        return bool(set(self.truth) & set(ranked[:1]))

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

    def names_exactly(self) -> bool:
        """Return whether the verdict names exactly the withheld effects."""
        return self.verdict == "named" and set(self.found) == set(self.truth)

    def finds_exactly(self) -> bool:
        """Return whether the composition is exactly the withheld effects."""
        return sorted(self.found) == sorted(self.truth)

    def finds_by_class(self) -> bool:
        """Return whether composition and withheld effects match one to one, each equal or indistinguishable."""
        return len(self.found) == len(self.truth) and any(
            all(map(self.is_same_class, self.truth, order)) for order in permutations(self.found)
        )

    def is_confidently_wrong(self) -> bool:
        """Return whether a cause that was not withheld was named with a probability of at least 0.9."""
        first = self.ranked[0] if self.ranked else ""
        is_sure = self.probability.get(first, 0.0) >= SURE_PROBABILITY
        return self.verdict == "named" and is_sure and first not in self.accepted | set(self.truth)


def build_case_outcome(
    label: Mapping[str, Any], gap: Mapping[str, Any], figures: Mapping[str, float], baselines: Mapping[str, str],
    seconds: float, mode: Mode,
) -> CaseOutcome:  # fmt: skip
    """Return the record of a case from its label, its `gap.json` and the causes that simpler methods name."""
    causes, rest = gap["causes"], gap["probabilities"]
    return CaseOutcome(
        **{key: label[key] for key in SAME},
        truth=tuple(effect["name"] for effect in label["effects"]),
        verdict=gap["verdict"],
        ranked=tuple(cause["effect"] for cause in causes),
        probability={**{c["effect"]: c["probability"] for c in causes}, NONE: rest["none"], UNKNOWN: rest["unknown"]},
        composition=tuple(gap["composition"]["effects"]),
        indistinguishable=tuple(frozenset(group) for group in gap["indistinguishable"]),
        figures=figures,
        baselines=baselines,
        seconds=seconds,
        mode=mode,
        covered=list_coverage(label, gap),
    )
