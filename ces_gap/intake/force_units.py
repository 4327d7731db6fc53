"""Detects a wrong sign or unit of a simulation by regression of the measured force on the simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_gap.errors import GapError
from ces_gap.trace import Trace

MIN_CORRELATION = 0.5  # correlation of the forces from which its sign and the scale count
SURE = 0.9  # correlation from which a factor that is physically plausible counts as a unit
NEAR = 0.06  # relative tolerance of such a factor
ROUGH = 3.0  # tolerance factor of powers of a thousand
IMPOSSIBLE = 30.0  # factor too large for a gap


@dataclass(frozen=True)
class ForceUnit:
    """A ratio of measured to simulated force with its explanation; `rough` allows the tolerance `ROUGH`."""

    factor: float
    description: str
    rough: bool


UNITS = (
    ForceUnit(1e3, "the simulation's force is in kN", True),
    ForceUnit(1e-3, "the measured force is in kN, or the simulation's in mN", True),
    ForceUnit(4.4482216, "the simulation's force is in lbf", False),
    ForceUnit(1.0 / 4.4482216, "the measured force is in lbf", False),
    ForceUnit(9.80665, "the simulation's force is in kgf", False),
    ForceUnit(1.0 / 9.80665, "the measured force is in kgf", False),
    ForceUnit(9.80665e-3, "the simulation's force is in gf", False),
    ForceUnit(1.0 / 9.80665e-3, "the measured force is in gf", False),
)


@dataclass(frozen=True)
class ForceAgreement:
    """Agreement of the forces: correlation, gain (slope of the reduced major axis), RMS [N] of both."""

    correlation: float
    gain: float
    measured_N: float
    simulated_N: float


def compare_forces(traces: Sequence[Trace]) -> ForceAgreement:
    """Compare measured and simulated force on all usable ticks."""
    measured = np.concatenate([t.force[t.usable] for t in traces])
    simulated = np.concatenate([t.simulated[t.usable] for t in traces])
    f, s = measured - measured.mean(), simulated - simulated.mean()
    spread_f, spread_s = float(np.sqrt(np.mean(f**2))), float(np.sqrt(np.mean(s**2)))
    if spread_f == 0.0 or spread_s == 0.0:
        return ForceAgreement(0.0, np.nan, spread_f, spread_s)
    correlation = float(np.mean(f * s)) / (spread_f * spread_s)
    return ForceAgreement(correlation, float(np.sign(correlation)) * spread_f / spread_s, spread_f, spread_s)


def require_same_sign_and_unit(traces: Sequence[Trace], name: str) -> None:
    """Raise GapError if the simulation `name` has the wrong sign, the wrong unit, or a constant force."""
    agreement = compare_forces(traces)
    if agreement.measured_N == 0.0 or agreement.simulated_N == 0.0:
        force = "the measured force" if agreement.measured_N == 0.0 else f"the force of {name}"
        raise GapError(f"{force} is constant; expected a force that changes with the stroke: check topic and field")
    mismatch = _describe_mismatch(agreement)
    if mismatch:
        raise GapError(f"{name}: {mismatch}")


def _describe_mismatch(agreement: ForceAgreement) -> str | None:
    unit = _find_unit(agreement)
    inverted = agreement.correlation <= -MIN_CORRELATION
    if unit is None and not inverted:
        return _describe_impossible_ratio(agreement)
    sign = "the simulated force has the opposite sign of the measured one" if inverted else ""
    what = " and ".join(filter(None, [sign, unit.description if unit else ""]))
    return (
        f"{what} (measured over simulated is {agreement.gain:.4g}, correlation {agreement.correlation:.2f}); "
        f"expected N, position and force positive in compression: {_describe_remedy(unit, inverted)}"
    )


def _find_unit(agreement: ForceAgreement) -> ForceUnit | None:
    if abs(agreement.correlation) < MIN_CORRELATION:
        return None
    for unit in UNITS:
        off = abs(np.log(abs(agreement.gain) / unit.factor))
        if off < (np.log(ROUGH) if unit.rough else NEAR) and (unit.rough or abs(agreement.correlation) >= SURE):
            return unit
    return None


def _describe_remedy(unit: ForceUnit | None, inverted: bool) -> str:
    if unit is None:
        return "invert the simulation's output, or set scale: -1.0 for position or force in the signals file"
    if unit.description.startswith("the measured"):
        return f"set scale: {(-1.0 if inverted else 1.0) / unit.factor:.6g} for force in the signals file"
    return f"multiply the simulation's output by {(-1.0 if inverted else 1.0) * unit.factor:.6g}"


def _describe_impossible_ratio(agreement: ForceAgreement) -> str | None:
    ratio = agreement.measured_N / agreement.simulated_N
    if 1.0 / IMPOSSIBLE < ratio < IMPOSSIBLE:
        return None
    return (
        f"its force changes by {agreement.simulated_N:.3g} N RMS, the measured one by {agreement.measured_N:.3g} N; "
        "expected the same damper in the same unit: check the units of the simulation and of the signals file"
    )
