"""A co-simulation FMU (FMI 2.0) as a simulation: a recording goes in, a force at each position sample comes out.

Communication points are the position stamps. An FMU that interpolates its inputs receives their derivatives; for any
other, the inputs at a step's end hold over the step, so that it adds no delay. After a gap a new instance starts. Needs
FMPy (the extra `fmi`). An FMU runs native code: use only FMUs that you trust.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ces_identify.numerics.arrays import F, I
from ces_identify.preparation.series import usable_samples
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.fmu_ports import SPEC, Ports, choose_ports, read_names
from ces_identify.simulations.fmu_slave import FmuVariables, extract_fmu, import_fmpy, open_instance, read_description
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError

GAP_S, GAP_INTERVALS = 0.05, 10.0  # a gap is longer than both, as in `ces_identify.preparation.sampling`
SMOOTHING_HZ = 70.0  # [Hz] zero-phase low-pass for the speed: above the stroke, below the noise of the position
MAX_STEPS = 50_000_000


@dataclass(frozen=True)
class FmuSimulation(Simulation):
    """An FMU with its `ports`; `step_s` is its fixed communication step [s], 0 if steps may vary."""

    path: str
    ports: Ports
    interpolates: bool
    step_s: float

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample; NaN at unusable or late samples, and where it is not valid.

        Raises CesError if the FMU fails or returns a force that is not finite.
        """
        samples = usable_samples(recording, 1e6)
        time = (samples.stamps_ns - samples.stamps_ns[0]) * 1e-9
        force = np.full(len(recording.channel("position")), np.nan)
        with extract_fmu(self.path) as (description, folder):
            for part in split_at_gaps(samples.stamps_ns):
                inputs = self._inputs(time[part], samples.position[part], samples.current[part])
                force[samples.index[part]] = self._run(description, folder, time[part], inputs)
        return force

    def _inputs(self, time: F, position: F, current: F) -> dict[str, F]:
        """Return the FMU's inputs by role, in its own units."""
        signals = {"position": position, "current": current}
        if "speed" in self.ports.inputs:
            signals["speed"] = smooth_speed(time, position)
        return {role: (signals[role] - port.offset) / port.factor for role, port in self.ports.inputs.items()}

    def _run(self, description: Any, folder: str, time: F, inputs: Mapping[str, F]) -> F:
        """Return the force [N] at the times of a stretch without a gap."""
        points = self._points(time)
        columns = [np.interp(points, time, inputs[role]) for role in self.ports.inputs]
        force = self._step_through(description, folder, points, np.stack(columns, axis=1))
        return force if points is time else np.asarray(np.interp(time, points, force))

    def _points(self, time: F) -> F:
        """Return the communication points [s]."""
        if self.step_s == 0.0 or len(time) < 2:
            return time
        count = int(np.ceil((time[-1] - time[0]) / self.step_s - 1e-9))
        if count > MAX_STEPS:
            raise CesError(f"{self.path}: {count} steps of {self.step_s:g} s; expected at most {MAX_STEPS}")
        return np.asarray(time[0] + self.step_s * np.arange(count + 1))

    def _step_through(self, description: Any, folder: str, points: F, inputs: F) -> F:
        """Step a new instance over the points; inputs (points, variables) in the FMU's units, force in N."""
        messages: list[str] = []
        at = float(points[0])
        force = np.empty(len(points))
        with np.errstate(over="ignore"):  # an outlier
            slopes = (np.diff(inputs, axis=0) / np.diff(points)[:, None]).tolist()
        values, times = inputs.tolist(), points.tolist()
        try:
            with open_instance(description, folder, messages) as slave:
                variables = FmuVariables(slave, self.ports)
                variables.start(at, values[0])
                force[0] = variables.force()
                for k, at in enumerate(times[:-1]):
                    now = (values[k], slopes[k]) if self.interpolates else (values[k + 1],)
                    variables.step(at, times[k + 1] - at, *now)
                    force[k + 1] = variables.force()
        except CesError:
            raise
        except Exception as error:
            reason = " ".join([str(error), *messages[-1:]]).replace("\n", " ")
            raise CesError(f"{self.path}: the FMU failed at {at:.6f} s: {reason}") from None
        invalid = np.isinf(force) if self.ports.valid is not None else ~np.isfinite(force)
        if invalid.any():
            bad = int(np.argmax(invalid))
            raise CesError(f"{self.path}: returned {force[bad]} N at {points[bad]:.3f} s; expected finite forces")
        return force


def open_fmu(spec: str) -> FmuSimulation:
    """Return the simulation `FILE.fmu` or `FILE.fmu:position=NAME,speed=NAME,current=NAME,force=NAME`.

    The file is only read; `force` runs it. Raises CesError if FMPy is missing, if the file is no FMI 2.0 co-simulation
    with a binary for this platform, or if its variables are ambiguous.
    """
    match = SPEC.fullmatch(spec)
    if match is None:
        raise CesError(f"{spec}: expected FILE.fmu or FILE.fmu:position=NAME,current=NAME,force=NAME")
    path, names = match[1], read_names(match[2] or "", spec)
    description = read_description(path)
    _require_runnable(path, description)
    capabilities = description.coSimulation
    return FmuSimulation(
        path,
        choose_ports(description, names, path),
        bool(capabilities.canInterpolateInputs),
        0.0 if capabilities.canHandleVariableCommunicationStepSize else _fixed_step(path, description),
    )


def split_at_gaps(stamps_ns: I) -> list[I]:
    """Return the indices of the samples of each stretch without a gap, in order, without late samples."""
    steps = np.abs(np.diff(stamps_ns))
    gap_ns = max(GAP_S * 1e9, GAP_INTERVALS * float(np.median(steps))) if len(steps) else 0.0
    parts = np.split(np.arange(len(stamps_ns)), np.flatnonzero(steps > gap_ns) + 1)
    latest = [np.maximum.accumulate(stamps_ns[part]) for part in parts]
    return [part[np.diff(so_far, prepend=so_far[:1] - 1) > 0] for part, so_far in zip(parts, latest, strict=True)]


def smooth_speed(time: F, position: F) -> F:
    """Return the smoothed speed (n,) [m/s], without delay, from positions [m] at increasing times [s]."""
    if len(time) < 3:
        return np.zeros(len(time))
    even = np.linspace(time[0], time[-1], len(time))
    rate = 1.0 / (even[1] - even[0])
    sos = butter(4, min(SMOOTHING_HZ, 0.2 * rate), fs=rate, output="sos")
    pad = min(len(time) - 1, round(0.2 * rate))
    smooth = sosfiltfilt(sos, np.interp(even, time, position), padlen=pad)
    return np.asarray(np.interp(time, even, np.gradient(smooth, even)))


def _require_runnable(path: str, description: Any) -> None:
    """Raise CesError unless this is FMI 2.0 co-simulation with a binary for this machine."""
    if description.fmiVersion != "2.0":
        raise CesError(f"{path}: FMI {description.fmiVersion}; expected FMI 2.0; export it again")
    if description.coSimulation is None:
        raise CesError(f"{path}: for model exchange only; expected co-simulation; export it again with its solver")
    here, there = import_fmpy().platform, import_fmpy().supported_platforms(path)
    if here not in there:
        has = ", ".join("sources" if platform == "c-code" else platform for platform in there) or "none"
        raise CesError(f"{path}: no binary for {here}; it has: {has}; compile or export it for this machine")


def _fixed_step(path: str, description: Any) -> float:
    experiment = description.defaultExperiment
    step = float(experiment.stepSize or 0.0) if experiment is not None else 0.0
    if not 0.0 < step < float("inf"):
        raise CesError(f"{path}: needs a fixed step but DefaultExperiment has no stepSize; export it again with one")
    return step
