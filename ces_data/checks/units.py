"""Magnitudes that no damper has: times, position, force and current in other units than s, m, N and A.

The limits hold from the damper of a bicycle to those of trucks and buildings. Stroke, speed, acceleration and damping
are judged together, and every unit is named with which all of them are those of a damper. A factor that lies inside
this range, such as lbf for N, cannot be known from one recording; `ratio_findings` finds it between recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from ces_data.arrays import F
from ces_data.checks.delays import is_reversed
from ces_data.checks.motion import MIN_S, RATE_HZ, RecordedMotion, is_constant, recorded_motion
from ces_data.findings import WARNING, WRONG_MODEL, Finding, finite_values, mean_rate
from ces_data.limits import DamperLimits, RatioLimits, StatisticLimits
from ces_data.recording import Recording
from ces_data.samples import is_rough
from ces_data.units import find_unit

SPEED_STEPS, MIN_TICKS = 5, 50  # samples of a speed; of a recording


def _scales(*units: str) -> dict[str, float]:
    """Return the factors to SI of units."""
    return {text: unit.scale for text in units if (unit := find_unit(text)) is not None}


FASTER, SLOWER = _scales("ms", "us", "ns"), {"s, not ms": 1e3, **_scales("min")}  # factors of times that are in it
LENGTHS, UNITS = _scales("mm", "cm", "inches", "um"), _scales("kN", "kip", "lbf", "kgf")
AS_MM = {text: 1e3 * scale for text, scale in _scales("m", "cm", "inches").items()}  # of positions taken for mm
AS_KN = {"N, not kN": 1e-3, "N, not kip": 1.0 / UNITS["kip"], "mN": 1e-3, "gf": 1e-3 * UNITS["kgf"]}


def unit_findings(recording: Recording, motion: RecordedMotion | None) -> Iterator[Finding]:
    """Yield a finding for the times, or for each signal whose magnitude speaks for another unit.

    Percentiles ignore outliers.
    """
    if clock := _clock(recording):
        yield clock
        return
    speed = float(np.percentile(np.abs(motion.speed), 99.0)) if motion is not None else 0.0
    force = half_span(finite_values(recording, "force"))
    yield from _position(half_span(finite_values(recording, "position")) * 2.0, motion, force)
    yield from _current(finite_values(recording, "current"))
    yield from _force(half_span(finite_values(recording, "force"), outside=0.1), speed)  # pulses count


def _clock(recording: Recording) -> Finding | None:
    """Return a finding if the position's rate and speeds are those of times in another unit."""
    if "position" not in recording.channels or len(sound := recording.channels["position"].in_order()) < MIN_TICKS:
        return None
    time, step = sound.stamps_ns * 1e-9, SPEED_STEPS
    rounded = mean_rate(recording.channels["position"])  # of stamps that are, each several times
    rate = max(1.0 / float(np.median(np.diff(time))), rounded)
    moved = np.abs(sound.values[step:] - sound.values[:-step]) / (time[step:] - time[:-step])
    speed = float(np.percentile(moved, 99.0))
    seconds = float(time[-1] - time[0])
    slow, fast = (
        rate < DamperLimits.MIN_RATE_HZ,
        rate > DamperLimits.MAX_RATE_HZ or (seconds < MIN_S and speed > DamperLimits.FAST_M_S),
    )
    if not (slow or fast or (rate < DamperLimits.SLOW_HZ and 0.0 < speed < DamperLimits.CREEPING_M_S)):
        return None

    def fits(factor: float) -> bool:
        return (
            2.0 * DamperLimits.MIN_RATE_HZ < rate / factor < 0.5 * DamperLimits.MAX_RATE_HZ
            and DamperLimits.CREEPING_M_S < speed / factor < DamperLimits.MAX_SPEED_M_S
        )

    units = [unit for unit, factor in (SLOWER if fast else FASTER).items() if fits(factor)]
    if not units and not slow and not (rate > DamperLimits.MAX_RATE_HZ and speed > DamperLimits.MAX_SPEED_M_S):
        return None
    text = f"position: sampled at {rate:.3g} Hz for {seconds:.3g} s, with speeds up to {speed:.2g} m/s"
    for unit in units:
        factor = {**FASTER, **SLOWER}[unit]
        text += f"; if the times are in {unit} ({rate / factor:.4g} Hz, {speed / factor:.2g} m/s), whatever their "
        text += f"column says, multiply the scale of time in the mapping file by {factor:g}"
    text += "" if units else ": too slow for a damper; check the times" if slow else ": check the times"
    sure = rate < DamperLimits.SLOWEST_HZ or (fast and speed > DamperLimits.MAX_SPEED_M_S)
    return Finding(WRONG_MODEL if sure else WARNING, text, "position")


def _name_scales(units: Mapping[str, float], fits: Callable[[float], bool]) -> str:
    """Return the factor of each unit that fits, or of all if none does: the rest of a remedy."""
    named = {unit: factor for unit, factor in units.items() if fits(factor)} or units
    parts = [f"by {factor:.6g} if it is in {unit}" for unit, factor in named.items()]
    return f"multiply its scale in the signals file {', '.join(parts)}"


def _position(stroke: float, motion: RecordedMotion | None, force: float) -> Iterator[Finding]:
    """Yield a finding if the piston moves farther, keeps moving faster, or accelerates more than any damper's."""
    moved = motion.speed if motion is not None else np.zeros(2)
    speed, rms = float(np.percentile(np.abs(moved), 99.0)), float(np.sqrt(np.mean(moved**2)))
    acceleration = float(np.percentile(np.abs(np.gradient(moved)), 99.0)) * RATE_HZ

    def fits(factor: float) -> bool:
        damping = force / (factor * speed) if speed > 0.0 else 0.0
        return (
            DamperLimits.MIN_STROKE_M < factor * stroke < DamperLimits.LONG_STROKE_M
            and factor * max(speed, 2.0 * rms) < DamperLimits.MAX_SPEED_M_S
            and factor * acceleration < DamperLimits.MAX_M_S2
            and (damping == 0.0 or DamperLimits.DAMPING_RANGE[0] < damping < DamperLimits.DAMPING_RANGE[1])
        )

    far = stroke > DamperLimits.MAX_STROKE_M or (stroke > DamperLimits.LONG_STROKE_M and speed > DamperLimits.FAST_M_S)
    if (
        far
        or speed > DamperLimits.MAX_SPEED_M_S
        or rms > DamperLimits.MAX_RMS_M_S
        or acceleration > DamperLimits.MAX_M_S2
    ):
        fast = f" at speeds up to {speed:.3g} m/s" if motion is not None else ""
        text = f"position: spans {stroke:.4g} m{fast}, more than any damper"
        yield Finding(WRONG_MODEL, f"{text}; {_name_scales(LENGTHS, fits)}", "position")
    elif rms > DamperLimits.USUAL_RMS_M_S or stroke > DamperLimits.LONG_STROKE_M:
        text = f"position: spans {stroke:.3g} m and moves at {rms:.2g} m/s on average (RMS), which few dampers do"
        yield Finding(WARNING, f"{text}; {_name_scales(LENGTHS, fits)}", "position")
    elif stroke > 0.0 and DamperLimits.STROKE_FORCE_N < force < DamperLimits.LARGE_FORCE_N:
        short = stroke < DamperLimits.SHORT_STROKE_M
        stiffest = DamperLimits.STIFF_N_S_M if short else DamperLimits.STIFFEST_N_S_M
        if stroke >= DamperLimits.MIN_STROKE_M and (speed == 0.0 or force < stiffest * speed):
            return
        text = f"position: spans {1e3 * stroke:.2g} mm at up to {1e3 * speed:.2g} mm/s with forces of {force:.3g} N"
        severity = (
            WRONG_MODEL if stroke < DamperLimits.MIN_STROKE_M and 0.0 < speed < DamperLimits.STILL_M_S else WARNING
        )
        yield Finding(severity, f"{text}; was it taken for mm? {_name_scales(AS_MM, fits)}", "position")


def _current(current: F) -> Iterator[Finding]:
    reach = float(np.percentile(np.abs(current), 99.0)) if len(current) else 0.0
    if reach > DamperLimits.MAX_CURRENT_A:
        remedy = "multiply its scale in the signals file by 0.001 if it is in mA, or by the factor from raw counts to A"
        yield Finding(WRONG_MODEL, f"current: reaches {reach:.4g} A, more than any valve; {remedy}", "current")
    elif reach > DamperLimits.VALVE_A:
        remedy = "if it is in mA, percent or raw counts, set its scale in the signals file, and the same on the vehicle"
        yield Finding(WARNING, f"current: reaches {reach:.4g} A; {remedy}", "current")
    elif 0.0 < reach < DamperLimits.WEAK_A and not is_rough(current):
        remedy = "was it taken for mA? Then multiply its scale in the signals file by 1000"
        yield Finding(WARNING, f"current: reaches {reach:.4g} A, which opens no valve; {remedy}", "current")


def _force(force: float, speed: float) -> Iterator[Finding]:
    def fits(factor: float) -> bool:
        damping = factor * force / max(speed, DamperLimits.MIN_SPEED_M_S)
        return (
            DamperLimits.FORCE_RANGE_N[0] < factor * force < DamperLimits.FORCE_RANGE_N[1]
            and damping < DamperLimits.DAMPING_RANGE[1]
        )

    if force > DamperLimits.LARGE_FORCE_N:
        what = "any damper" if force > DamperLimits.MAX_FORCE_N else "any damper of a vehicle"
        text = f"force: reaches {force:.3g} N, more than {what}; {_name_scales(AS_KN, fits)}"
        yield Finding(WRONG_MODEL if force > DamperLimits.MAX_FORCE_N else WARNING, text, "force")
    if force == 0.0 or speed < DamperLimits.MIN_SPEED_M_S:
        return
    what = f"force: {force:.3g} N at {speed:.2g} m/s ({force / speed:.2g} N s/m)"
    if force < DamperLimits.FRICTION_N and force / speed < DamperLimits.DAMPING_N_S_M:
        text = f"{what}, less than the friction of any damper's seals; {_name_scales(UNITS, fits)}"
        yield Finding(WRONG_MODEL, text, "force")
    elif force < DamperLimits.TINY_FORCE_N or (
        force < DamperLimits.SMALL_FORCE_N and force / speed < DamperLimits.SMALL_DAMPING_N_S_M
    ):
        yield Finding(WARNING, f"{what} is little for a damper; {_name_scales(UNITS, fits)}", "force")


def half_span(values: F, without: float = 0.0, outside: float = 1.0) -> float:
    """Return half the range of values (n,) but for `outside` percent on each side, `without` if there are none."""
    return float(0.5 * np.ptp(np.percentile(values, (outside, 100.0 - outside)))) if len(values) else without


def find_exchange(recording: Recording, motion: RecordedMotion | None) -> Finding | None:
    """Return a finding if both ranges are the other signal's and the force returns work; mm and kN do not."""
    stroke, force = (half_span(finite_values(recording, name)) for name in ("position", "force"))
    if (
        motion is None
        or 2.0 * stroke < DamperLimits.MAX_STROKE_M
        or force > DamperLimits.FRICTION_N
        or not is_reversed(motion, None)
    ):
        return None
    text = (
        f"position: spans {2.0 * stroke:.4g} m, while the force reaches {force:.3g} N and acts with the motion: "
        "position and force are interchanged, or both are in other units and one of them is reversed; check topics, "
        "fields and scales in the signals file"
    )
    return Finding(WRONG_MODEL, text, "position")


SPEEDS, CURRENTS = 12, 4  # cells, over the range that all recordings share


def ratio_findings(recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Yield a finding for each recording whose forces are in another unit than those of the first."""
    motions = [(r.name, m) for r in recordings if (m := recorded_motion(r)) is not None]
    for (first, reference), (name, motion) in zip(motions[:1] * len(motions), motions[1:], strict=False):
        slope = _slope(reference, motion)
        if unit := _find_unit(slope):
            small, large = (name, first) if slope < 1.0 else (first, name)
            driven = not (is_constant(motion.current) or is_constant(reference.current))
            severity = WRONG_MODEL if driven else WARNING  # without a current, the valve may have been set differently
            text = f"force: {max(slope, 1.0 / slope):.3g} times as large in {large} as in {small} at equal speeds and"
            remedy = f"if {small} is in {unit}, multiply its scale in the signals file by {UNITS[unit]:.6g}"
            yield Finding(severity, f"{text} currents; {remedy}", "force")


def _find_unit(slope: float) -> str | None:
    """Return the unit whose ratio to N, or N's to it, a slope is."""
    for unit, newtons in UNITS.items():
        for ratio in (newtons, 1.0 / newtons):
            if 1.0 / RatioLimits.NEAR < slope / ratio < RatioLimits.NEAR:
                return unit
    return None


def _slope(first: RecordedMotion, other: RecordedMotion) -> float:
    """Return by what the forces of `other` exceed those of `first` in the cells of both; NaN if they are unlike."""
    edges = [
        np.linspace(max(a.min(), b.min()), min(a.max(), b.max()), cells + 1)
        for a, b, cells in ((first.speed, other.speed, SPEEDS), (first.current, other.current, CURRENTS))
    ]
    if np.ptp(edges[0]) <= 0.0 or edges[1][0] > edges[1][-1]:
        return np.nan
    x, y = (_cell_means(motion, *edges) for motion in (first, other))
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < RatioLimits.MIN_CELLS or x[both].std() == 0.0 or y[both].std() == 0.0:
        return np.nan
    correlation = float(np.corrcoef(x[both], y[both])[0, 1])
    return float(y[both].std() / x[both].std()) if correlation > RatioLimits.MIN_CORRELATION else np.nan


def _cell_means(motion: RecordedMotion, speeds: F, currents: F) -> F:
    """Return the mean force [N] in each cell of speed and current, NaN in cells with few ticks."""
    inside = (motion.speed >= speeds[0]) & (motion.speed < speeds[-1])
    if np.ptp(currents) > 0.0:
        inside &= (motion.current >= currents[0]) & (motion.current < currents[-1])
    rows = np.clip(np.searchsorted(speeds, motion.speed[inside], side="right") - 1, 0, SPEEDS - 1)
    columns = np.clip(np.searchsorted(currents, motion.current[inside], side="right") - 1, 0, CURRENTS - 1)
    cells = rows * CURRENTS + columns
    count = np.bincount(cells, minlength=SPEEDS * CURRENTS)
    total = np.bincount(cells, motion.force[inside], minlength=SPEEDS * CURRENTS)
    return np.where(count >= RatioLimits.MIN_CELL_TICKS, total / np.maximum(count, 1), np.nan)


def unit_against_model(measured: F, simulated: F) -> Iterator[Finding]:
    """Yield a finding if the measured force (n,) is the simulated one in another unit."""
    if measured.std() == 0.0 or simulated.std() == 0.0:
        return
    slope = float(measured.std() / simulated.std())
    unit = _find_unit(slope)
    if unit is None or float(np.corrcoef(measured, simulated)[0, 1]) < RatioLimits.MIN_CORRELATION:
        return
    remedy = f"if it is in {unit}, multiply its scale in the signals file by {UNITS[unit]:.6g}"
    if slope >= 1.0:
        remedy = (
            f"if the model was identified in {unit}, multiply the scale of the force by {UNITS[unit]:.6g} in the "
            "signals file it was identified with, and identify again"
        )
    yield Finding(WRONG_MODEL, f"force: {slope:.3g} times as large as the model's; {remedy}", "force")


def explain_simulation(measured: F, simulated: F) -> str:
    """Return that a simulation's force (n,) is the measured one of opposite sign, or in another unit; '' if neither."""
    if measured.std() == 0.0 or not 0.0 < simulated.std() < np.inf:
        return ""
    correlation, slope = float(np.corrcoef(measured, simulated)[0, 1]), float(measured.std() / simulated.std())
    if correlation < -RatioLimits.MIN_CORRELATION:
        return "the simulated force has the opposite sign; force and position are positive in compression"
    if correlation < RatioLimits.MIN_CORRELATION or 1.0 / RatioLimits.SPREAD < slope < RatioLimits.SPREAD:
        return ""
    return f"the measured force is {slope:.3g} times as large as the simulated one; are both in N?"


def signs_against_model(cost: float, reversed_cost: float) -> Iterator[Finding]:
    """Yield a finding if a model follows a recording better by far with position and force both reversed.

    The costs J [%] are those of its free runs on the recording as it is, and reversed. A damper that acts alike in
    compression and rebound shows no difference, and needs none.
    """
    if cost > 100.0 * StatisticLimits.EXPLAINED and reversed_cost < RatioLimits.HALVED * cost:
        text = (
            f"position and force: the model follows them better with both signs reversed (J {reversed_cost:.0f} "
            f"instead of {cost:.0f} %); both are positive in compression: multiply both scales by -1 in the signals "
            "file of the recording, or identify the model again if its own was wrong"
        )
        yield Finding(WRONG_MODEL, text)
