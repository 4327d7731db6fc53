"""Makes the cases of a plan and seals their answers: labels packed against accidental reading, bound by a hash.

A case's folder receives what a user would have. `seal.json` holds a random salt and the packed labels, which contain
the hashes of the arrays in `seal/`. The SHA-256 of salt and labels is published beside the cases: it reveals nothing,
and the answers can no longer be changed.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import os
import secrets
import shutil
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from ces_data.arrays import F
from ces_data.bags.writer import TopicData, recording_topics, write_bag
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_observer.fields import Field
from ces_observer.json_text import write_atomically
from ces_observer.records import Record, read_document, read_record, write_record
from ces_rig.blind.plan import HELD_OUT, NOISE_N, REAL, REFERENCE, BlindCase, DrawnCase, IdealRecording, draw_case
from ces_rig.errors import RigError
from ces_rig.experiments.virtual import RigForce, load_rig
from ces_rig.sensors import EPOCH_NS, Sensor, Sensors, measure_signals
from ces_rig.withheld.plants import physical_numbers, rms

Arrays = Mapping[str, NDArray[np.float32]]
SpareEffects = Sequence[tuple[str, ...]]

SCHEMA = "ces-blind/1"


@dataclass(frozen=True)
class WithheldLabel:
    """A withheld effect: its severity, and the numbers that it gives the plant or the sensor."""

    name: str
    severity: float = 0.0
    physical: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class CaseLabel:
    """The sealed answer of a case: what is withheld from its simulation, and what that makes of the force."""

    case: str
    kind: str
    plant: str = ""
    excitation: str = ""
    gap_to_noise: float = 0.0
    baseline_ratio: float = 0.0
    effects: tuple[WithheldLabel, ...] = ()
    gap_N: float = 0.0
    noise_N: float = NOISE_N
    baseline_error_N: float = 0.0
    planned: tuple[str, ...] = ()
    arrays_sha256: str = ""


@dataclass(frozen=True)
class SealedAnswers:
    """What the seal holds: facts about the whole test, and the answers of its cases."""

    about: Mapping[str, Any]
    labels: tuple[CaseLabel, ...]


@dataclass(frozen=True)
class CaseDescription:
    """What a case's folder says of itself; recordings and simulation are named relative to it."""

    case: str
    excitation: str
    real: tuple[str, ...]
    reference: tuple[str, ...]
    held_out: tuple[str, ...]
    simulation: str
    predictions: str
    about: str


CASE = Field(kind=Record(CaseDescription))
WRITTEN = ("cases", "seal", "seal.json")
GROUPS = {"real": REAL, "reference": REFERENCE, "held_out": HELD_OUT}
CASE_SCHEMA = "ces-blind-case/1"
BASELINE, DESCRIPTION, PREDICTIONS = "baseline.yaml", "case.json", "sim_force"
SENSORS = Sensors(
    position=Sensor(noise=4e-6, quantum=2e-6, phase_s=0.4e-3, jitter_s=5e-6),
    current=Sensor(noise=1e-3, quantum=0.5e-3, phase_s=0.35e-3, jitter_s=5e-6),
    force=Sensor(noise=NOISE_N, quantum=1.0, phase_s=0.6e-3, jitter_s=5e-6),
)
"""Fast, quiet sensors: otherwise errors of the simulation's inputs would cost more force than the force sensor's noise,
and `gap_to_noise` would be too optimistic."""


def write_case(drawn: DrawnCase, folder: Path) -> tuple[CaseLabel, Arrays]:
    """Write the case to `folder` (new); return its label, and noise-free arrays at the samples of scored recordings.

    Nothing in the folder reveals the effect: names, order, stamps and file times are the same in every case.
    """
    folder.mkdir(parents=True)
    (folder / BASELINE).write_text(yaml.safe_dump(drawn.simulated.description(), sort_keys=True), encoding="utf-8")
    simulation = load_rig(folder / BASELINE)
    arrays: dict[str, NDArray[np.float32]] = {}
    for group, name in ((group, name) for group, names in GROUPS.items() for name in names):
        recording = measure_signals(drawn.recordings[name].true, SENSORS, drawn.seeds[name], name)
        simulated = _simulate(simulation, recording)
        valid = np.isfinite(simulated)
        stamps = recording.channel("position").stamps_ns[valid]
        predictions = TopicData(PREDICTIONS, "std_msgs/msg/Float64", stamps, {"data": simulated[valid]})
        write_bag(folder / group / name, [*recording_topics(recording, load_signals()), predictions])
        if name not in REFERENCE:
            arrays |= _noise_free_arrays(name, drawn.recordings[name], recording, simulated)
    described = CaseDescription(
        case=f"{drawn.case.number:04d}",
        excitation=drawn.case.excitation,
        **{group: tuple(f"{group}/{name}" for name in names) for group, names in GROUPS.items()},
        simulation=BASELINE,
        predictions=f"topic:/{PREDICTIONS}",
        about="synthetic; if anything is withheld from the simulation it is in real and held_out, not in reference",
    )
    text = json.dumps({"schema": CASE_SCHEMA, **write_record(described)}, indent=1) + "\n"
    (folder / DESCRIPTION).write_text(text, encoding="utf-8")
    for path in (*folder.rglob("*"), folder):
        os.utime(path, (EPOCH_NS // 1_000_000_000, EPOCH_NS // 1_000_000_000))
    return _make_label(drawn, arrays), arrays


def read_case(folder: Path) -> CaseDescription:
    """Return the description of the case in `folder`; raises RigError."""
    path = folder / DESCRIPTION
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RigError(f"{path}: cannot be read ({error}); expected one from 'ces blind make'") from None
    described: CaseDescription = read_document(CASE, values, str(path), CASE_SCHEMA, "run 'ces blind make'", RigError)
    return described


def _simulate(simulation: RigForce, recording: Recording) -> F:
    """Return the simulated force [N] at the position samples (n,), NaN before the first current."""
    position, current = recording.channel("position"), recording.channel("current")
    newest = np.searchsorted(current.stamps_ns, position.stamps_ns, side="right") - 1
    known, time = newest >= 0, (position.stamps_ns - position.stamps_ns[0]) * 1e-9
    force = np.full(len(position), np.nan)
    force[known] = simulation(time[known], position.values[known], current.values[newest[known]])
    return force


def _noise_free_arrays(name: str, ideal: IdealRecording, recording: Recording, simulated: F) -> Arrays:
    """Return the noise-free signals and the simulated force at the stamps of the position samples."""
    true = ideal.true
    at = (recording.channel("position").stamps_ns - EPOCH_NS) * 1e-9
    columns = {
        "force_N": PchipInterpolator(true.time_s, true.force_N)(at),
        "effect_N": PchipInterpolator(true.time_s, ideal.effect_N)(at),
        "baseline_N": simulated,
    }
    return {f"{name}_{key}": np.asarray(values, np.float32) for key, values in columns.items()}


def _make_label(drawn: DrawnCase, arrays: Arrays) -> CaseLabel:
    case = drawn.case
    force, effect, baseline = (
        np.concatenate([arrays[f"{name}_{key}"] for name in REAL]).astype(np.float64)
        for key in ("force_N", "effect_N", "baseline_N")
    )
    error = force - effect - baseline
    return CaseLabel(
        case=f"{case.number:04d}",
        kind=case.kind,
        plant=drawn.plant_name,
        excitation=case.excitation,
        gap_to_noise=case.gap_to_noise,
        baseline_ratio=case.baseline_ratio,
        effects=tuple(WithheldLabel(w.name, w.severity, physical_numbers(drawn.plant, w)) for w in drawn.withheld),
        gap_N=rms(effect),
        baseline_error_N=rms(error[np.isfinite(error)]),
    )


def write_arrays(folder: Path, case: str, arrays: Arrays) -> str:
    """Write `seal/CASE.npz` under `folder` and return its SHA-256."""
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)  # type: ignore[arg-type]
    path = folder / "seal" / f"{case}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(packed.getvalue())
    return hashlib.sha256(packed.getvalue()).hexdigest()


def write_seal(folder: Path, about: Mapping[str, Any], labels: Sequence[CaseLabel]) -> str:
    """Write `seal.json` and `cases/seal.sha256` under `folder` and return the published hash."""
    text = json.dumps(write_record(SealedAnswers(dict(about), tuple(labels))), allow_nan=False)
    packed = base64.b85encode(zlib.compress(text.encode(), 9)).decode()
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    salt = secrets.token_hex(32)
    digest = _digest(salt, packed)
    write_atomically(folder / "seal.json", json.dumps({"schema": SCHEMA, "salt": salt, "labels": packed}) + "\n")
    write_atomically(folder / "cases" / "seal.sha256", f"{digest}\n")
    return digest


def open_seal(folder: Path) -> SealedAnswers:
    """Return what the seal holds; raises RigError if it was changed after sealing."""
    try:
        published = (folder / "cases" / "seal.sha256").read_text(encoding="utf-8").strip()
        sealed = json.loads((folder / "seal.json").read_text(encoding="utf-8"))
        salt, packed = str(sealed["salt"]), str(sealed["labels"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RigError(f"{folder}: not a sealed blind test ({error}); expected one from 'ces blind make'") from None
    if _digest(salt, packed) != published:
        raise RigError(f"{folder}/seal.json: its hash is not the published one in cases/seal.sha256; it was changed")
    content = json.loads(zlib.decompress(base64.b85decode(packed)))
    return read_record(SealedAnswers, content, f"{folder}/seal.json", RigError)


def read_seal(folder: Path) -> str:
    """Return the published hash that shows which results and cases belong together; empty if there is none."""
    path = folder / "cases" / "seal.sha256"
    return path.read_text(encoding="utf-8").strip() if path.is_file() else ""


def open_arrays(folder: Path, label: CaseLabel) -> dict[str, F]:
    """Return the sealed arrays of a case; raises RigError if they are missing or were changed after sealing."""
    path = folder / "seal" / f"{label.case}.npz"
    if not path.is_file():
        raise RigError(f"{path}: missing; copy it from the output of 'ces blind make'")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != label.arrays_sha256:
        raise RigError(f"{path}: its hash is not the sealed one; it was changed")
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        return {name: arrays[name].astype(np.float64) for name in arrays.files}


def _digest(salt: str, packed: str) -> str:
    return hashlib.sha256(f"{salt}\n{packed}".encode()).hexdigest()


def make_cases(
    folder: Path, plan: Sequence[tuple[BlindCase, SpareEffects]], seconds: float, processes: int,
    about: Mapping[str, Any], on_label: Callable[[CaseLabel], None],
) -> str:  # fmt: skip
    """Write cases and seal to a new `folder`, labels to `on_label`; return the published hash. Raises CesError."""
    if folder.exists() and any(folder.iterdir()):
        raise RigError(f"{folder}: is not empty; choose another folder for the cases")
    import joblib  # type: ignore[import-untyped]

    (folder / "cases").mkdir(parents=True, exist_ok=True)
    labels = []
    tasks = (joblib.delayed(make_case)(folder, case, seconds, spare) for case, spare in plan)
    try:
        with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
            for label in joblib.Parallel(n_jobs=processes, batch_size=1, return_as="generator")(tasks):
                labels.append(label)
                on_label(label)
    except BaseException:
        for name in ("cases", "seal"):
            shutil.rmtree(folder / name, ignore_errors=True)
        raise
    return write_seal(folder, {**about, "seconds": seconds}, sorted(labels, key=lambda label: label.case))


def remove_cases(folder: Path) -> None:
    """Remove the cases and the seal in `folder`; raises RigError if it holds anything else."""
    inside = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    other = [name for name in inside if name not in WRITTEN]
    if other:
        raise RigError(f"{folder}: holds more than blind cases ({other[0]}), so it is not replaced; choose another")
    for name in inside:
        shutil.rmtree(folder / name) if (folder / name).is_dir() else (folder / name).unlink()


def make_case(folder: Path, case: BlindCase, seconds: float, spare_effects: SpareEffects) -> CaseLabel:
    """Make one case and return its label; raises CesError."""
    label, arrays = write_case(draw_case(case, seconds, spare_effects), folder / "cases" / f"{case.number:04d}")
    return replace(label, planned=tuple(case.effects), arrays_sha256=write_arrays(folder, label.case, arrays))
