"""The rig's servo-hydraulic actuator: a commanded stroke goes in, the numbers and inputs of its kernel come out.

It follows a command late, with limited bandwidth, and gives way to the damper's force. A small disturbance, new in
every run, keeps two runs of one command from being equal. The levels are those of a mid-size servo-hydraulic dyno.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.random import Generator
from scipy.signal import butter, sosfilt

from ces_data.arrays import F
from ces_observer.records import quantity
from ces_rig.errors import RigError

SETTLING_S = 2.0  # [s] the disturbance's filter runs before the command begins
FADE_S = 0.1  # [s] the disturbance grows from 0, so that a run begins at rest
NOISE_BANDWIDTH = pi / (2.0 * 2.0**0.5)  # of a second-order Butterworth filter, over its cutoff


@dataclass(frozen=True)
class ServoActuator:
    """The actuator's settings; the equations are those of `kernels.py`."""

    gain: float = quantity(1.0, "1", "position over command at rest", 0.2, 5.0)
    delay_s: float = quantity(0.004, "s", "dead time of the command", 0.0, 0.2)
    bandwidth_Hz: float = quantity(35.0, "Hz", "natural frequency of the position loop", 0.5, 500.0)
    damping: float = quantity(0.8, "1", "damping ratio of the position loop", 0.1, 5.0)
    valve_s: float = quantity(0.001, "s", "time constant of the servo valve; 0: second order", 0.0, 0.2)
    compliance_m_N: float = quantity(1e-7, "m/N", "deviation per force of the damper", 0.0, 1e-4)
    stroke_m: float = quantity(0.058, "m", "hard ends, either way", 1e-3, 0.5)
    speed_m_s: float = quantity(2.0, "m/s", "largest speed (flow of the valve)", 1e-3, 20.0)
    acceleration_m_s2: float = quantity(400.0, "m/s²", "largest acceleration (pressure)", 0.1, 5e3)
    disturbance_m: float = quantity(20e-6, "m", "RMS of the disturbance of the command, new in every run", 0.0, 0.01)
    disturbance_Hz: float = quantity(10.0, "Hz", "cutoff of the disturbance's second-order filter", 0.1, 200.0)

    def numbers(self) -> F:
        """Return the numbers of `ServoNumbers`, shape (SERVO_SIZE,)."""
        response = 2.0 * pi * self.bandwidth_Hz, self.damping, self.valve_s, self.compliance_m_N
        return np.array([*response, self.stroke_m, self.speed_m_s, self.acceleration_m_s2])

    def require_within(self, reach_m: float) -> None:
        """Raise RigError if the actuator reaches beyond the damper's ends at ±`reach_m`."""
        if self.stroke_m > reach_m:
            ends = f"the damper's ends are at ±{reach_m:g} m from mid-stroke"
            raise RigError(f"actuator: stroke_m is {self.stroke_m:g}; {ends}; choose less")

    def loop_input(self, time_s: F, command_m: F, rng: Generator) -> F:
        """Return the position loop's input [m] at the uniform times (n,): command with gain, delay and disturbance."""
        late = np.interp(time_s - self.delay_s, time_s, command_m)
        rate = 1.0 / (time_s[1] - time_s[0])
        lead = round(SETTLING_S * rate)
        sos = butter(2, self.disturbance_Hz, fs=rate, output="sos")
        noise = sosfilt(sos, rng.standard_normal(lead + len(time_s)))[lead:]
        noise_rms = np.sqrt(2.0 * self.disturbance_Hz / rate * NOISE_BANDWIDTH)
        disturbance = self.disturbance_m / noise_rms * noise * np.minimum(1.0, (time_s - time_s[0]) / FADE_S)
        return np.asarray(self.gain * late + disturbance)
