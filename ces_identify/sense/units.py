"""Magnitudes that no damper has: position, force and current in other units than m, N and A.

The limits hold from the damper of a bicycle to that of a truck. A factor that lies inside this range, such as lbf for
N, cannot be known from one recording; `consistency` finds it between recordings.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding, finite_values
from ces_identify.recordings.recording import Recording
from ces_identify.sense.motion import RATE_HZ, Motion

MAX_STROKE_M, MAX_SPEED_M_S = 1.0, 10.0  # of a damper on a rig or a vehicle
MAX_RMS_M_S, MAX_M_S2 = 2.0, 1000.0  # over the whole recording: the oil would boil; wheels on a kerb stay below 500
USUAL_RMS_M_S = 1.3  # of a sine that peaks at 1.8 m/s, which few dynamometers reach
MIN_STROKE_M, STROKE_FORCE_N = 1e-4, 100.0  # a shorter stroke makes no force like this
MAX_CURRENT_A, VALVE_A = 100.0, 30.0  # beyond any valve; beyond those of vehicles
FORCE_N, DAMPING_N_S_M = 8.0, 40.0  # the seal's friction alone is more; half of the softest bicycle damper
SMALL_FORCE_N, SMALL_DAMPING_N_S_M = 30.0, 200.0  # a small damper, or kN
MIN_SPEED_M_S = 0.02  # below it hardly any force is to be expected
MAX_FORCE_N = 1e6


def unit_findings(recording: Recording, motion: Motion | None) -> Iterator[Finding]:
    """Yield a finding for each signal whose magnitude speaks for another unit; percentiles ignore outliers."""
    speed = float(np.percentile(np.abs(motion.speed), 99.0)) if motion is not None else 0.0
    force = half_span(finite_values(recording, "force"))
    yield from _position(half_span(finite_values(recording, "position")) * 2.0, motion, force)
    yield from _current(finite_values(recording, "current"))
    yield from _force(force, speed)


def _position(stroke: float, motion: Motion | None, force: float) -> Iterator[Finding]:
    """Yield a finding if the piston moves farther, keeps moving faster, or accelerates more than any damper's."""
    moved = motion.speed if motion is not None else np.zeros(2)
    speed, rms = float(np.percentile(np.abs(moved), 99.0)), float(np.sqrt(np.mean(moved**2)))
    acceleration = float(np.percentile(np.abs(np.gradient(moved)), 99.0)) * RATE_HZ
    if stroke > MAX_STROKE_M or speed > MAX_SPEED_M_S or rms > MAX_RMS_M_S or acceleration > MAX_M_S2:
        yield Finding(
            WRONG_MODEL,
            f"position: spans {stroke:.4g} m at speeds up to {speed:.3g} m/s, more than any damper; multiply its scale "
            "in the signals file by 0.001 if it is in mm, by 0.01 if it is in cm, by 0.0254 if it is in inches",
            signal="position",
        )
    elif rms > USUAL_RMS_M_S:
        yield Finding(
            WARNING,
            f"position: moves at {rms:.2g} m/s on average (RMS), which few dampers do; if it is in inches, multiply "
            "its scale in the signals file by 0.0254",
            signal="position",
        )
    elif 0.0 < stroke < MIN_STROKE_M and force > STROKE_FORCE_N:
        yield Finding(
            WARNING,
            f"position: spans {1e3 * stroke:.2g} mm with forces of {force:.3g} N; if it was in m already, remove "
            "scale: 0.001 from the signals file",
            signal="position",
        )


def _current(current: F) -> Iterator[Finding]:
    reach = float(np.percentile(np.abs(current), 99.0)) if len(current) else 0.0
    if reach > MAX_CURRENT_A:
        yield Finding(
            WRONG_MODEL,
            f"current: reaches {reach:.4g} A, more than any valve; multiply its scale in the signals file by 0.001 if "
            "it is in mA, or by the factor from raw counts to A",
            signal="current",
        )
    elif reach > VALVE_A:
        yield Finding(
            WARNING,
            f"current: reaches {reach:.4g} A; if it is in mA, percent or raw counts, set its scale in the signals "
            "file, and the same on the vehicle",
            signal="current",
        )


def _force(force: float, speed: float) -> Iterator[Finding]:
    if force > MAX_FORCE_N:
        yield Finding(
            WRONG_MODEL,
            f"force: reaches {force:.3g} N, more than any damper; multiply its scale in the signals file by 0.001 if "
            "it is in mN, by 0.00981 if it is in gf",
            signal="force",
        )
    if force == 0.0 or speed < MIN_SPEED_M_S:
        return
    what = f"force: {force:.3g} N at {speed:.2g} m/s ({force / speed:.2g} N s/m)"
    if force < FORCE_N and force / speed < DAMPING_N_S_M:
        yield Finding(
            WRONG_MODEL,
            f"{what}, less than the friction of any damper's seals; multiply its scale in the signals file by 1000 if "
            "it is in kN",
            signal="force",
        )
    elif force < SMALL_FORCE_N and force / speed < SMALL_DAMPING_N_S_M:
        yield Finding(
            WARNING,
            f"{what} is little for a damper; if it is in kN, multiply its scale in the signals file by 1000",
            signal="force",
        )


def half_span(values: F) -> float:
    """Return half the range of values (n,) between the 1st and 99th percentile, 0 if there are none."""
    return float(0.5 * np.ptp(np.percentile(values, (1.0, 99.0)))) if len(values) else 0.0
