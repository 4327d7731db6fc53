"""Names and numbers for readers: effects, axes, parameters with units, figures with intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ces_gap.diagnosis import Estimate, GapRegion, Interval
from ces_gap.inference.judgement import CALIBRATION, PARAMETERS, TIMING
from ces_report.typesetting import format_number, format_range, format_within, join_with, minus

AXES = {
    "stroke_m": ("stroke", "mm", 1e3),
    "speed_m_s": ("speed", "m/s", 1.0),
    "current_A": ("current", "A", 1.0),
    "direction": ("direction", "", 1.0),
    "frequency_hz": ("frequency", "Hz", 1.0),
    "since_reversal_s": ("time since reversal", "ms", 1e3),
    "elapsed_s": ("elapsed time", "s", 1.0),
    "heat_J": ("dissipated heat", "kJ", 1e-3),
}  # name, displayed unit, factor from SI to it
SIDES = ("rebound", "compression")
UNITS = {  # by the suffix of a parameter's name, longer suffixes first
    "_N_s2_m2_A": "N·s²/(m²·A)", "_N_s_m_A": "N·s/(m·A)", "_N_s2_m2": "N·s²/m²", "_N_s_m2": "N·s/m²",
    "_N_m_A": "N/(m·A)", "_N_A2": "N/A²", "_N_A": "N/A", "_samples2": "samples²", "_samples": "samples",
    "_m_s_rtN": "m/(s·√N)", "_m_sN": "m/(s·N)", "_m_N": "m/N", "_per_N": "1/N", "_per_K": "1/K", "_per_J": "1/J",
    "_N_s_m": "N·s/m", "_N_m2": "N/m²", "_N_m3": "N/m³", "_N_m": "N/m", "_N_s": "N/s", "_N_K": "N/K",
    "_m_s": "m/s", "_s_m": "s/m", "_kg": "kg", "_Hz": "Hz", "_Pa": "Pa", "_N": "N", "_m": "m", "_s": "s",
    "_A": "A", "_K": "K", "_J": "J",
}  # fmt: skip
DISPLAY_UNITS = {
    "m": ("mm", 1e3, 0.0, 0.1),
    "s": ("ms", 1e3, 0.0, 0.1),
    "A": ("mA", 1e3, 0.0, 0.1),
    "m/N": ("mm/kN", 1e6, 0.0, 1e-3),
    "N/m": ("N/mm", 1e-3, 1e4, math.inf),
}  # displayed unit, its factor, and the range of the largest number in SI for which it is used
PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck", "lugre": "LuGre"}
OWN = {CALIBRATION: "calibration", TIMING: "timing", PARAMETERS: "parameters"}


def effect_name(effect: str) -> str:
    """Return `valve_lag` as `valve lag`, `coulomb_stribeck` as `Coulomb Stribeck`."""
    if effect in OWN:
        return f"the simulation's {OWN[effect]}"
    return " ".join(PROPER.get(word, word) for word in effect.split("_"))


def join_effect_names(effects: Sequence[str], last: str = "and") -> str:
    """Return `a, b and c`."""
    return join_with([effect_name(e) for e in effects], last) or "nothing"


def sentence_case(text: str) -> str:
    """Return the text with its first letter in upper case."""
    return text[:1].upper() + text[1:]


def axis_title(axis: str) -> str:
    """Return an axis as `Speed [m/s]`."""
    name, unit, _ = AXES[axis]
    return sentence_case(name) + (f" [{unit}]" if unit else "")


def axis_figure(axis: str, value: float, figures: int = 3) -> str:
    """Return a value on an axis in the displayed unit; `∞` for an open end."""
    return format_number(AXES[axis][2] * value + 0.0, figures)


def axis_range(axis: str, low: float, high: float) -> str:
    """Return a range on an axis in the displayed unit, such as `0.1 to 0.3 m/s`."""
    _, unit, scale = AXES[axis]
    return f"{format_range(scale * low + 0.0, scale * high + 0.0)} {unit}".rstrip()


def region_name(region: GapRegion) -> str:
    """Return a region as `speed 0.1 to 0.3 m/s`, `stroke above 20 mm`, `rebound`."""
    if region.axis == "direction":
        both = region.low < 0.0 < region.high
        return " and ".join(SIDES) if both else SIDES[int(region.low + region.high > 0.0)]
    name, unit, _ = AXES[region.axis]
    if math.isinf(region.high):
        return f"{name} above {axis_figure(region.axis, region.low)} {unit}"
    if math.isinf(region.low):
        return f"{name} below {axis_figure(region.axis, region.high)} {unit}"
    return f"{name} {axis_range(region.axis, region.low, region.high)}"


def parameter_text(estimate: Estimate) -> tuple[str, str, str, str]:
    """Return a parameter's name, value, unit and 95 % interval, in a unit that gives convenient numbers."""
    suffix = next((e for e in UNITS if estimate.name.endswith(e)), "")
    unit, scale = UNITS.get(suffix, ""), 1.0
    display_unit, factor, at_least, below = DISPLAY_UNITS.get(unit, (unit, scale, 0.0, math.inf))
    if at_least <= max(abs(v) for v in (estimate.value, *estimate.ci95)) < below:
        unit, scale = display_unit, factor
    low, high = (scale * end for end in estimate.ci95)
    value, interval = format_within(scale * estimate.value, low, high)
    return effect_name(estimate.name.removesuffix(suffix)), value, unit, interval


def parameter_as_declared(estimate: Estimate) -> tuple[str, str, str, str]:
    """Return the same of a user's parameter, whose name need not end with its unit: name and numbers as they are."""
    value, interval = format_within(estimate.value, *estimate.ci95)
    return estimate.name, value, "", interval


def newtons(value: float) -> str:
    """Return a force as `8.1 N`."""
    return f"{format_number(value)} N"


def percent(share: float) -> str:
    """Return a share as a whole percentage, a dash if it is unknown."""
    if not math.isfinite(share):
        return "\N{EN DASH}"
    return "<1" if 0.0 < share < 0.005 else minus(f"{100.0 * share:.0f}").replace("\N{MINUS SIGN}0", "0")


def percents(interval: Interval) -> str:
    """Return an interval of shares as `85 to 92 %`, a dash if it is unknown."""
    if not all(map(math.isfinite, interval)):
        return "\N{EN DASH}"
    low, high = map(percent, interval)
    text = f"{low} to {high}" if low != high else low
    return f"{text}\N{NO-BREAK SPACE}%"
