"""Whether the reported 95 % intervals contain the true parameters, where the withheld effect has the same parameter.

`COUNTERPARTS` maps a parameter of the library to the physical numbers of the sealed label. Most effects of the rig have
no such number: they follow other laws than the forms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ces_rig.dampers.kinds import KINDS

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
            true = _find_truth(effect, name, values, label["plant"])
            if true is not None and None not in parameter["ci95"]:
                low, high = parameter["ci95"]
                hits.append(low <= true <= high)
    return tuple(hits)


def _find_truth(effect: Mapping[str, Any], parameter: str, values: Numbers, plant: str) -> float | None:
    find = COUNTERPARTS.get((effect["name"], parameter))
    return None if find is None else find(effect["physical"], values, plant)


def _read_number(*paths: str) -> Counterpart:
    """Return the number at the first of the paths that the effect has."""
    return lambda true, _values, _plant: next((true[path] for path in paths if path in true), None)


def _subtract_design(*paths: str) -> Counterpart:
    """Return how much the effect adds to the number of the plant's design, which does not vary between plants."""

    def find(true: Numbers, _values: Numbers, plant: str) -> float | None:
        path = next((path for path in paths if path in true), None)
        return None if path is None else true[path] - KINDS[plant].design.number(path)

    return find


def _find_added_stiffness(*paths: str) -> Counterpart:
    """Return the stiffness that the effect puts in series, unless the bushing relaxes or stiffens."""

    def find(true: Numbers, values: Numbers, plant: str) -> float | None:
        path = next((path for path in paths if path in true), None)
        if path is None or len(true) != len(("stiffness", "damping")) or "knee_N" in values:
            return None
        return 1.0 / (1.0 / true[path] - 1.0 / KINDS[plant].design.number(path))

    return find


def _gain(true: Numbers, values: Numbers, _plant: str) -> float | None:
    return 1.0 / (1.0 + true["gain"]) if "offset_A" in values else None


def _offset_A(true: Numbers, _values: Numbers, _plant: str) -> float | None:
    return -true["offset_A"] / (1.0 + true["gain"])


def _delay(true: Numbers, _values: Numbers, _plant: str) -> float | None:
    """Return minus the delay of the logged position; a late one is also filtered."""
    shifted = true["delay_s"] < 0.0 or true["lag_share"] <= MAX_LAG_SHARE
    return -true["delay_s"] if shifted else None


def _plays(true: Numbers, values: Numbers, plant: str) -> float | None:
    """Return the half width of the magnetic loop, if the law is that of the form (plays, or remanence)."""
    path = "remanence_A" if "travel_A" in values else "ces_valve.hysteresis_A"
    return _subtract_design(path)(true, values, plant)


def _opposite(find: Counterpart) -> Counterpart:
    def negate(true: Numbers, values: Numbers, plant: str) -> float | None:
        value = find(true, values, plant)
        return None if value is None else -value

    return negate


_clearance = _read_number("body.bump_clearance_m", "stop_clearance_m")
COUNTERPARTS: Mapping[tuple[str, str], Counterpart] = {
    ("force_offset", "offset_N"): _read_number("offset_N"),
    ("current_scale", "gain"): _gain,
    ("current_scale", "offset_A"): _offset_A,
    ("position_delay", "delay_s"): _delay,
    ("inertia", "mass_kg"): _subtract_design("body.moving_mass_kg", "mass_kg"),
    ("backlash", "gap_m"): _subtract_design("mount.play_m", "play_m"),
    ("mount_compliance", "stiffness_N_m"): _find_added_stiffness("mount.stiffness_N_m", "mount_N_m"),
    ("bump_stop", "compression_m"): _clearance,
    ("bump_stop", "rebound_m"): _opposite(_clearance),
    ("bump_stop", "stiffness_N_m"): _read_number("body.bump_stiffness_N_m", "stop_N_m"),
    ("friction", "coulomb_N"): _subtract_design("seal_N"),
    ("leakage", "leak_m_sN"): _subtract_design("bypass_m_Ns"),
    ("current_hysteresis", "hysteresis_A"): _plays,
    ("current_hysteresis", "travel_A"): _read_number("remanence_bend_A"),
}
