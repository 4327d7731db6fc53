"""Regions, parameters and numbers of a diagnosis as text for the terminal."""

from __future__ import annotations

import math

from ces_gap.calibration_map import CalibrationCell
from ces_gap.diagnosis import Estimate, Explanation, GapRegion
from ces_gap.report.formatting import parameter_text, region_name


def region_text(region: GapRegion) -> str:
    """Return a region with its share of the gap's energy and of the time."""
    energy = f"{region.share_of_energy:.0%} of the gap's energy"
    if region.axis == "frequency_hz":
        return f"{energy} at {region_name(region)}"
    return (
        f"{energy} in {region.share_of_samples:.0%} of the time at {region_name(region)} (RMS {newtons(region.rms_N)})"
    )


def effect_name(cause: Explanation) -> str:
    """Return an effect with its form."""
    return f"{cause.effects[0]} ({cause.forms[0]})"


def estimate(parameter: Estimate) -> str:
    """Return a parameter with its value, interval and doubts."""
    marks = (" at its bound" if parameter.at_bound else "") + (" drifts" if parameter.drifts else "")
    name, value, unit, bounds = parameter_text(parameter)
    return f"{' '.join(filter(None, (name, value, unit)))} [{bounds}]{marks}"


def calibration_text(cell: CalibrationCell) -> str:
    """Return what a calibration adds in one range of speed and current."""
    (slow, fast), (low, high) = cell.speed_m_s, cell.current_A
    return f"calibration: {cell.force_N:+.1f} N at {slow:.2f} to {fast:.2f} m/s, {low:.2f} to {high:.2f} A"


def newtons(value: float) -> str:
    """Return a force."""
    return f"{value:.1f} N" if math.isfinite(value) else "unknown"


def interval(bounds: tuple[float, float]) -> str:
    """Return an interval of forces [N]."""
    return f"[{bounds[0]:.1f}, {bounds[1]:.1f}]"


def percent(share: float) -> str:
    """Return a share."""
    return f"{100.0 * share:.0f} %" if math.isfinite(share) else "unknown"


def percent_interval(bounds: tuple[float, float]) -> str:
    """Return an interval of shares in percent."""
    return f"[{100.0 * bounds[0]:.0f}, {100.0 * bounds[1]:.0f}]" if all(map(math.isfinite, bounds)) else "unknown"


def probability(value: float) -> str:
    """Return a probability; small ones as `<0.01`."""
    return "<0.01" if 0.0 < value < 0.005 else f"{value:.2f}"
