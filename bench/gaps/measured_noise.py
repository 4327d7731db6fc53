"""Accuracy of the noise measured by each source, on the virtual rig, printed as the Markdown table of docs/diagnose.md.

    python -m bench.gaps.measured_noise

The hydraulic damper runs without sensor noise; white noise is added, the sum may pass a low-pass of the logger, and it
is rounded to 1 N. The true noise is that of the force on the trace's grid. It takes about half a minute.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfilt

import bench.blas_one_thread  # noqa: F401 - before NumPy
from ces_gap.sensor_noise.noise_estimate import CYCLES, HIGH_FREQUENCIES, STANDSTILL, MeasuredNoise
from ces_gap.trace import Trace, make_trace
from ces_identify.recordings.recording import Recording
from ces_rig.experiment import parse_experiment, run

F = NDArray[np.float64]

NOISE_N, QUANTUM_N, SECONDS = 8.0, 1.0, 20.0
RATES_HZ = (1000.0, 200.0)
CONSTANT = {"kind": "constant", "current_A": 0.6}
DRIVES: Mapping[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "sine 2 Hz": ({"kind": "sine", "amplitude_m": 0.02, "frequency_Hz": 2.0}, CONSTANT),
    "noise": (
        {"kind": "noise", "peak_to_peak_m": 0.07, "cutoff_Hz": 8.0},
        {"kind": "filtered_noise", "cutoff_Hz": 4.0},
    ),
    "sweep to 12 Hz": (
        {"kind": "sweep", "from_Hz": 0.5, "to_Hz": 12.0, "amplitude_m": 0.02, "speed_m_s": 0.5},
        CONSTANT,
    ),
    "rest, current steps": ({"kind": "rest"}, {"kind": "steps", "levels_A": [0.2, 1.0, 0.6], "hold_s": 2.0}),
}
LOGGERS: Mapping[str, Callable[[F, float], F]] = {
    "none": lambda values, rate_Hz: values,
    "60 Hz, 2nd order": lambda values, rate_Hz: sosfilt(butter(2, 60.0, fs=rate_Hz, output="sos"), values),
    "exponential, 0.25": lambda values, rate_Hz: lfilter([0.25], [1.0, -0.75], values),
}
SOURCES = (CYCLES, STANDSTILL, HIGH_FREQUENCIES)
HEADER = ("rate Hz", "stroke", "logger's filter", "true N", *SOURCES, "used", "over the true noise")


def main() -> None:
    """Print the table."""
    print(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}", flush=True)
    for rate_Hz in RATES_HZ:
        for drive in DRIVES:
            clean = _record_clean(drive, rate_Hz)
            for logger in LOGGERS:
                noise, true_N = _measure(clean, LOGGERS[logger], rate_Hz)
                print(f"| {rate_Hz:.0f} | {drive} | {logger} | {true_N:.2f} | {_describe(noise, true_N)} |", flush=True)


def _record_clean(drive: str, rate_Hz: float) -> Recording:
    stroke, current = DRIVES[drive]
    sensors = {"force": {"noise": 0.0, "quantum": 0.0, "rate_Hz": rate_Hz}, "position": {"rate_Hz": rate_Hz}}
    description = {"duration_s": SECONDS, "seed": 3, "stroke": stroke, "current": current, "sensors": sensors}
    return run(parse_experiment(description, drive))


def _measure(clean: Recording, logger: Callable[[F, float], F], rate_Hz: float) -> tuple[MeasuredNoise, float]:
    """Return the noise found, and the true one on the grid [N]."""
    force = clean.channel("force").values
    noise = NOISE_N * np.random.default_rng(5).standard_normal(len(force))
    start = float(force[0])
    bare = logger(force - start, rate_Hz) + start
    noisy = _trace(clean, QUANTUM_N * np.round((bare + logger(noise, rate_Hz)) / QUANTUM_N))
    return noisy.measured_noise, float((noisy.force - _trace(clean, bare).force)[noisy.usable].std())


def _trace(recording: Recording, force_N: F) -> Trace:
    force = replace(recording.channel("force"), values=force_N)
    channels = {**recording.channels, "force": force}
    return make_trace(replace(recording, channels=channels), np.zeros(len(recording.channel("position"))))


def _describe(noise: MeasuredNoise, true_N: float) -> str:
    """Return the ratio of each source to the true noise, in brackets if the source says that it cannot know."""
    used = {noise.source: (noise.rms_N, noise.known)}
    found = {e.source: (e.rms_N, e.valid) for e in noise.others} | used

    def cell(source: str) -> str:
        rms_N, valid = found[source]
        return f"{rms_N / true_N:.2f}" if valid else f"({rms_N / true_N:.2f})" if rms_N else "-"

    return " | ".join(
        [*map(cell, SOURCES), noise.source if noise.known else "not known", f"{noise.rms_N / true_N:.2f}"]
    )


if __name__ == "__main__":
    main()
