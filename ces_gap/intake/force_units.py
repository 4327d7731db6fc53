"""A simulation in the wrong sign or unit, told apart from a gap: regression of the measured force on the simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_gap.errors import GapError
from ces_gap.trace import Trace

MIN_CORRELATION = 0.5  # correlation of measured with simulated force from which its sign and its scale count
SURE = 0.9  # correlation from which a factor that physics could nearly give counts as a unit
NEAR = 0.06  # relative, of such a factor
ROUGH = 3.0  # factor within which powers of a thousand are recognised
IMPOSSIBLE = 30.0  # factor that no gap has


@dataclass(frozen=True)
class ForceUnit:
    """A factor of measured over simulated force, and what explains it; `rough` if nothing else comes near."""

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
    """How measured and simulated force go together: correlation, gain (slope of the reduced major axis), RMS [N]."""

    correlation: float
    gain: float
    measured_N: float
    simulated_N: float


def compare_forces(traces: Sequence[Trace]) -> ForceAgreement:
    """Return how the measured force of all usable ticks goes with the simulated."""
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
    found = compare_forces(traces)
    if found.measured_N == 0.0 or found.simulated_N == 0.0:
        who = "the measured force" if found.measured_N == 0.0 else f"the force of {name}"
        raise GapError(f"{who} is constant; expected one that changes with the stroke: check topic and field")
    told = _describe_mismatch(found)
    if told:
        raise GapError(f"{name}: {told}")


def _describe_mismatch(found: ForceAgreement) -> str | None:
    unit = _find_unit(found)
    turned = found.correlation <= -MIN_CORRELATION
    if unit is None and not turned:
        return _describe_impossible_ratio(found)
    sign = "the simulation's force goes against the measured one" if turned else ""
    what = " and ".join(filter(None, [sign, unit.description if unit else ""]))
    return (
        f"{what} (measured over simulated is {found.gain:.4g}, correlation {found.correlation:.2f}); expected N, and "
        f"position and force positive in compression: {_describe_remedy(unit, turned)}"
    )


def _find_unit(found: ForceAgreement) -> ForceUnit | None:
    if abs(found.correlation) < MIN_CORRELATION:
        return None
    for unit in UNITS:
        off = abs(np.log(abs(found.gain) / unit.factor))
        if off < (np.log(ROUGH) if unit.rough else NEAR) and (unit.rough or abs(found.correlation) >= SURE):
            return unit
    return None


def _describe_remedy(unit: ForceUnit | None, turned: bool) -> str:
    if unit is None:
        return "turn the simulation's output round, or give position or force scale: -1.0 in the signals file"
    if unit.description.startswith("the measured"):
        return f"give force scale: {(-1.0 if turned else 1.0) / unit.factor:.6g} in the signals file"
    return f"multiply the simulation's output by {(-1.0 if turned else 1.0) * unit.factor:.6g}"


def _describe_impossible_ratio(found: ForceAgreement) -> str | None:
    ratio = found.measured_N / found.simulated_N
    if 1.0 / IMPOSSIBLE < ratio < IMPOSSIBLE:
        return None
    return (
        f"its force changes by {found.simulated_N:.3g} N RMS, the measured one by {found.measured_N:.3g} N; expected "
        "the same damper in the same unit: check the units of the simulation and of the signals file"
    )
