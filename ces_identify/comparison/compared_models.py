"""What is compared: models with the recordings that they know, their forces at the same stamps.

Each model runs freely at its own rate and delay over the whole recording. Its force at a position sample is the one
that the observer would publish for it, so all forces have the recording's own position stamps; the measured force is
interpolated to them. Only stamps count at which every model has a force.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ces_data.arrays import F, Mask
from ces_data.checks.content import find_known_recording, identification_rows
from ces_data.recording import Recording
from ces_identify.limits import ComparisonLimits, TickLimits
from ces_identify.prepare.series import force_at
from ces_identify.simulations.simulate import SampleRun, sample_run
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.validation.evaluate import UNITS as SIGNAL_UNITS
from ces_identify.validation.evaluate import RangeUse, describe_held, find_outside
from ces_observer.errors import RecordingError
from ces_observer.model import Model

TRAINED, TEST, UNKNOWN = "identified on", "test", "not known"
FITTED_ROLES = ("identification", "real", "reference")  # of recordings in a model's and an augmented.json's provenance

TrainingRow = Mapping[str, Any]  # a recording in a provenance: name, hash, share and marks


@dataclass(frozen=True)
class ComparedModel:
    """A simulation with the name that tables and charts show, and its `source` (a path or the like).

    `trained_on` describes the recordings that it was identified on; `training_known` is False if there may be others,
    because no file says so.
    """

    name: str
    simulation: Simulation
    source: str = ""
    trained_on: tuple[TrainingRow, ...] = ()
    training_known: bool = False

    @property
    def model(self) -> Model | None:
        """The model if it is one, None for any other simulation."""
        return self.simulation.model if isinstance(self.simulation, ModelSimulation) else None

    def use_of(self, recording: Recording, part: tuple[float, float]) -> str:
        """Return TRAINED if the model was identified on some of this `part` of the recording, TEST, or UNKNOWN."""
        if find_known_recording(recording, {"identification": list(self.trained_on)}, part):
            return TRAINED
        return TEST if self.training_known and recording.sha256 else UNKNOWN


def make_compared_model(name: str, simulation: Simulation, source: str = "") -> ComparedModel:
    """Return the simulation with the recordings that the provenance of its file names."""
    inside = simulation.innermost
    provenances = [getattr(simulation, "provenance", {})] if inside is not simulation else []
    provenances += [inside.model.provenance] if isinstance(inside, ModelSimulation) else [{}]
    listed = [{"identification": one.get(role)} for one in provenances for role in FITTED_ROLES]
    rows = tuple(row for one in listed for row in identification_rows(one))
    known = all(provenances) and all(row.get("sha256") or row.get("marks") for row in rows)
    return ComparedModel(name, simulation, source, rows, known)


def name_sources(sources: Sequence[str]) -> list[str]:
    """Return a name for each path or specification: the file's stem, with its folders where stems are equal."""

    def end_of(source: str, depth: int) -> str:
        path = Path(source)
        last = path.stem if path.suffix in (".json", ".yaml", ".yml") else path.name
        return "/".join([*path.parts[-depth:-1], last])

    names = []
    for source in sources:
        others = [other for other in sources if other != source]
        depths = (n for n in range(1, 6) if all(end_of(source, n) != end_of(other, n) for other in others))
        names.append(end_of(source, next(depths, 5)))
    return names


@dataclass(frozen=True)
class AlignedRecording:
    """Forces of all models on one recording, at its position samples (n,).

    `time_s` counts from the first sample; `position` [m] and `speed` [m/s] are shown only. `measured` (n,) and `forces`
    (models, n) [N] are NaN where there is none; `scored` (n,) is true where all of them count. `diverged` says which
    models have a force that is not finite or, of those without an envelope, exceeds MAX_RATIO times the measured force.
    `exits` lists the signals outside each model's input envelope, `holds` tells of forces held at its force envelope
    (empty if none was).
    """

    name: str
    sha256: str
    source: str
    rate_Hz: float
    time_s: F
    position: F
    speed: F
    measured: F
    forces: F
    scored: Mask
    diverged: tuple[bool, ...]
    exits: tuple[tuple[RangeUse, ...], ...]
    holds: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """Scored time [s]."""
        return float(self.scored.sum()) / self.rate_Hz

    @property
    def errors(self) -> F:
        """Measured minus simulated force [N] at the scored samples (models, m), NaN for a model that diverged."""
        return np.asarray(self.measured[self.scored] - self.forces[:, self.scored])


def align(models: Sequence[ComparedModel], recording: Recording, part: tuple[float, float]) -> AlignedRecording:
    """Run all models over `recording`; stamps outside its `part` (shares from 0 to 1) are not scored.

    Raises RecordingError if there are too few stamps at which all models and the measurement have a force.
    """
    if "force" not in recording.channels:
        raise RecordingError(f"{recording.name}: no measured force to compare with; describe it in the signals file")
    position = recording.channel("position")
    stamps, n = position.stamps_ns, len(position.stamps_ns)
    measured, time_s = force_at(recording, stamps, ComparisonLimits.MAX_GAP_S), (stamps - stamps[0]) * 1e-9
    runs = [_run(model, recording, measured) for model in models]
    forces, diverged = np.stack([force for force, _, _ in runs]), tuple(lost for _, _, lost in runs)
    counted = np.isfinite(measured) & np.isfinite(position.values) & _past_warm_up(time_s)
    counted &= (np.arange(n) >= round(part[0] * n)) & (np.arange(n) < round(part[1] * n))
    counted &= (np.isfinite(forces) | np.array(diverged)[:, None]).all(axis=0)
    if counted.sum() < TickLimits.MIN_SCORED:
        raise RecordingError(
            f"{recording.name}: {counted.sum()} samples at which all models and the measurement have a force past "
            f"warm-up; expected at least {TickLimits.MIN_SCORED}: compare on a longer recording, or leave out the "
            "model that has no force there"
        )
    if np.ptp(measured[counted]) == 0.0:
        what = "measured force is constant; check its topic and field in the signals file"
        raise RecordingError(f"{recording.name}: {what}")
    speeds = (np.append(run.series.speed, np.nan)[run.newest] for _, run, _ in runs if run is not None)
    speed = next(speeds, None)  # of the first model, for charts
    speed = np.asarray(np.gradient(position.values, time_s)) if speed is None else speed
    return AlignedRecording(
        name=recording.name,
        sha256=recording.sha256,
        source=recording.source,
        rate_Hz=1.0 / float(np.median(np.diff(time_s))),
        time_s=time_s,
        position=position.values,
        speed=speed,
        measured=measured,
        forces=forces,
        scored=counted,
        diverged=diverged,
        exits=tuple(_find_exits(model, run, counted) for model, (_, run, _) in zip(models, runs, strict=True)),
        holds=tuple("" if run is None else describe_held(recording.name, *run.held_at(counted)) for _, run, _ in runs),
    )


def _run(model: ComparedModel, recording: Recording, measured: F) -> tuple[F, SampleRun | None, bool]:
    """Return the force, the run if it is a model, and whether it diverged; others do far beyond the measured force."""
    if model.model is not None:
        run = sample_run(model.model, recording)
        return run.force, run, not np.isfinite(run.run.force).all()
    force = model.simulation.force(recording)
    limit = ComparisonLimits.MAX_RATIO * float(np.nanmax(np.abs(measured), initial=0.0))
    diverged = limit > 0.0 and bool(np.nanmax(np.abs(force), initial=0.0) > limit)
    return np.full(len(force), np.nan) if diverged else force, None, diverged


def _past_warm_up(time_s: F) -> Mask:
    """Return where the last start or gap is at least WARM_UP_S ago."""
    starts = np.flatnonzero(np.diff(time_s, prepend=-np.inf) > ComparisonLimits.MAX_GAP_S)
    began = time_s[starts[np.searchsorted(starts, np.arange(len(time_s)), side="right") - 1]]
    return np.asarray(time_s - began >= ComparisonLimits.WARM_UP_S)


def _find_exits(model: ComparedModel, run: SampleRun | None, counted: Mask) -> tuple[RangeUse, ...]:
    if model.model is None or run is None:
        return ()
    ticks = np.unique(run.newest[counted & (run.newest >= 0)])
    return find_outside(model.model, {name: getattr(run.series, name)[ticks] for name in SIGNAL_UNITS})
