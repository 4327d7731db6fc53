"""Writes a drawn case: its folder receives what a user would have; the answer is returned for the seal.

Nothing in the folder reveals the effect: names, order, stamps and file times are the same in every case.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from ces_identify.recordings.bag_writer import TopicData, recording_topics, write_bag
from ces_identify.recordings.recording import Recording
from ces_identify.recordings.signals_file import load_signals
from ces_identify.simulations.simulation import FunctionSimulation
from ces_rig.blind.draw import HELD_OUT, NOISE_N, REAL, REFERENCE, DrawnCase, IdealRecording
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.drive.currents import ConstantLevel
from ces_rig.drive.strokes import Common, Rest, Stroke
from ces_rig.experiment import EPOCH_NS, Experiment, ExperimentSettings, Truth, measure
from ces_rig.sensors import Sensor, Sensors
from ces_rig.simulation import load_rig
from ces_rig.withheld.plants import physical_numbers
from ces_rig.withheld.scaling import rms

Array = NDArray[np.float64]
Arrays = Mapping[str, NDArray[np.float32]]

GROUPS = {"real": REAL, "reference": REFERENCE, "held_out": HELD_OUT}
BASELINE, DESCRIPTION, PREDICTIONS = "baseline.yaml", "case.json", "sim_force"
SENSORS = Sensors(
    position=Sensor(noise=4e-6, quantum=2e-6, phase_s=0.4e-3, jitter_s=5e-6),
    current=Sensor(noise=1e-3, quantum=0.5e-3, phase_s=0.35e-3, jitter_s=5e-6),
    force=Sensor(noise=NOISE_N, quantum=1.0, phase_s=0.6e-3, jitter_s=5e-6),
)
"""Fast, quiet sensors: otherwise errors of the simulation's inputs would cost more force than the force sensor's noise,
and `gap_to_noise` would be too optimistic."""
EPOCH_S = EPOCH_NS // 1_000_000_000


@dataclass(frozen=True)
class CaseAnswer:
    """The sealed answer of a case: its label, and noise-free arrays at the position samples of scored recordings."""

    label: dict[str, Any]
    arrays: Arrays


def write_case(drawn: DrawnCase, folder: Path) -> CaseAnswer:
    """Write the case to `folder` (new) and return its answer; raises CesError."""
    folder.mkdir(parents=True)
    (folder / BASELINE).write_text(
        yaml.safe_dump(drawn.simulated.model.description(), sort_keys=True), encoding="utf-8"
    )
    simulation = FunctionSimulation(BASELINE, load_rig(folder / BASELINE))
    arrays: dict[str, NDArray[np.float32]] = {}
    for group, name in ((group, name) for group, names in GROUPS.items() for name in names):
        recording = log_sensors(drawn.recordings[name].true, name, drawn.seeds[name])
        simulated = simulation.force(recording)
        _write_bag(folder / group / name, recording, simulated)
        if name not in REFERENCE:
            arrays |= _noise_free_arrays(name, drawn.recordings[name], recording, simulated)
    (folder / DESCRIPTION).write_text(json.dumps(_describe_case(drawn), indent=1) + "\n", encoding="utf-8")
    _equalise_times(folder)
    return CaseAnswer(_make_label(drawn, arrays), arrays)


def log_sensors(true: Truth, name: str, seed: int) -> Recording:
    """Return the recording of the true signals by the rig's sensors."""
    settings = ExperimentSettings(name=name, duration_s=float(true.time_s[-1]), seed=seed)
    still = Stroke(Rest(), Common())  # not used: `true` already contains stroke and current
    return measure(Experiment(settings, still, ConstantLevel(0.0), Damper(), SENSORS), true)


def _write_bag(path: Path, recording: Recording, simulated: Array) -> None:
    valid = np.isfinite(simulated)
    stamps = recording.channel("position").stamps_ns[valid]
    predictions = TopicData(PREDICTIONS, "std_msgs/msg/Float64", stamps, {"data": simulated[valid]})
    write_bag(path, [*recording_topics(recording, load_signals()), predictions])


def _noise_free_arrays(
    name: str, ideal: IdealRecording, recording: Recording, simulated: Array
) -> dict[str, NDArray[np.float32]]:
    """Return the noise-free signals and the simulated force at the stamps of the position samples."""
    true = ideal.true
    at = (recording.channel("position").stamps_ns - EPOCH_NS) * 1e-9
    motion = CubicSpline(true.time_s, true.stroke_m)
    columns = {
        "force_N": PchipInterpolator(true.time_s, true.force_N)(at),
        "effect_N": PchipInterpolator(true.time_s, ideal.effect_N)(at),
        "baseline_N": simulated,
        "stroke_m": motion(at),
        "speed_m_s": motion(at, 1),
    }
    return {f"{name}_{key}": np.asarray(values, np.float32) for key, values in columns.items()}


def _describe_case(drawn: DrawnCase) -> dict[str, Any]:
    return {
        "schema": "ces-blind-case/1",
        "case": f"{drawn.case.number:04d}",
        "excitation": drawn.case.excitation,
        **{group: [f"{group}/{name}" for name in names] for group, names in GROUPS.items()},
        "simulation": BASELINE,
        "predictions": f"topic:/{PREDICTIONS}",
        "about": "synthetic; if anything is withheld from the simulation it is in real and held_out, not in reference",
    }


def _make_label(drawn: DrawnCase, arrays: Arrays) -> dict[str, Any]:
    case = drawn.case
    force, effect, baseline = (
        np.concatenate([arrays[f"{name}_{key}"] for name in REAL]).astype(np.float64)
        for key in ("force_N", "effect_N", "baseline_N")
    )
    error = force - effect - baseline
    return {
        "case": f"{case.number:04d}",
        "kind": case.kind,
        "plant": drawn.plant.kind,
        "excitation": case.excitation,
        "gap_to_noise": case.gap_to_noise,
        "baseline_ratio": case.baseline_ratio,
        "effects": [
            {"name": w.name, "severity": w.severity, "physical": physical_numbers(drawn.plant, w)}
            for w in drawn.withheld
        ],
        "gap_N": rms(effect),
        "noise_N": NOISE_N,
        "baseline_error_N": rms(error[np.isfinite(error)]),
    }


def _equalise_times(folder: Path) -> None:
    """Give every file and folder the same modification time."""
    for path in (*folder.rglob("*"), folder):
        os.utime(path, (EPOCH_S, EPOCH_S))
