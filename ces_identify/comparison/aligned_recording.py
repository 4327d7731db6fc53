"""All models on one recording: their forces and the measured one at the same stamps.

Each model runs freely at its own rate, with its own differentiator, over the whole recording. Its force at a position
sample is the one that the observer would publish for it, so all forces have the recording's own position stamps; the
measured force is interpolated to them. Only stamps count at which every model has a force.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.comparison.compared_model import ComparedModel
from ces_identify.numerics.arrays import F, Mask
from ces_identify.preparation.series import force_at, hold_current
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulate import SampleRun, sample_run
from ces_identify.validation.envelope_use import UNITS as SIGNAL_UNITS
from ces_identify.validation.envelope_use import RangeUse, find_outside
from ces_observer.errors import RecordingError

WARM_UP_S = 0.5  # [s] not scored after the start and after each gap, for models that ask for less
MAX_GAP_S = 0.05  # [s] over which the measured force is interpolated, as in `ces_observer.model.Sampling`
MIN_SCORED = 50
MAX_RATIO = 1000.0  # of a simulated to the largest measured force, for simulations that have no envelope


@dataclass(frozen=True)
class AlignedRecording:
    """Forces of all models on one recording, at its position samples (n,).

    `time_s` counts from the first sample; `position` [m] and `speed` [m/s] are shown only. `measured` (n,) and `forces`
    (models, n) [N] are NaN where there is none; `scored` (n,) is true where all of them count. `diverged` says which
    models left their force envelope, or have none and exceed MAX_RATIO times the measured force. `exits` lists the
    signals outside each model's input envelope, `ranges` holds the lowest and highest position [m], speed [m/s] and
    current [A] at the scored samples.
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
    ranges: Mapping[str, tuple[float, float]]

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
    stamps = position.stamps_ns
    measured = force_at(recording, stamps, MAX_GAP_S)
    runs = [_run(model, recording) for model in models]
    forces = np.stack([force for force, _ in runs])
    diverged = tuple(_is_endless(force, measured) if run is None else run.run.diverged >= 0 for force, run in runs)
    forces[np.array(diverged) & np.array([run is None for _, run in runs])] = np.nan
    time_s = (stamps - stamps[0]) * 1e-9
    counted = np.isfinite(measured) & np.isfinite(position.values) & _past_warm_up(time_s) & _in_part(len(stamps), part)
    for force, lost in zip(forces, diverged, strict=True):
        counted &= np.isfinite(force) | lost
    _require_enough(recording.name, counted, measured)
    speed, current = _find_speed(runs, time_s, position.values), hold_current(recording, stamps, 1e6)
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
        exits=tuple(_find_exits(model, run, counted) for model, (_, run) in zip(models, runs, strict=True)),
        ranges={
            name: (float(np.nanmin(values[counted])), float(np.nanmax(values[counted])))
            for name, values in (("position", position.values), ("speed", speed), ("current", current))
        },
    )


def _run(model: ComparedModel, recording: Recording) -> tuple[F, SampleRun | None]:
    if model.model is None:
        return model.simulation.force(recording), None
    run = sample_run(model.model, recording)
    return run.force, run


def _is_endless(force: F, measured: F) -> bool:
    """Return whether a simulated force is far beyond the measured one."""
    limit = MAX_RATIO * float(np.nanmax(np.abs(measured), initial=0.0))
    return limit > 0.0 and bool(np.nanmax(np.abs(force), initial=0.0) > limit)


def _past_warm_up(time_s: F) -> Mask:
    """Return where the last start or gap is at least WARM_UP_S ago."""
    starts = np.flatnonzero(np.diff(time_s, prepend=-np.inf) > MAX_GAP_S)
    began = time_s[starts[np.searchsorted(starts, np.arange(len(time_s)), side="right") - 1]]
    return np.asarray(time_s - began >= WARM_UP_S)


def _in_part(n: int, part: tuple[float, float]) -> Mask:
    index = np.arange(n)
    return np.asarray((index >= round(part[0] * n)) & (index < round(part[1] * n)))


def _require_enough(name: str, counted: Mask, measured: F) -> None:
    count = int(counted.sum())
    if count < MIN_SCORED:
        raise RecordingError(
            f"{name}: {count} samples at which all models and the measurement have a force past warm-up; expected at "
            f"least {MIN_SCORED}: compare on a longer recording, or leave out the model that has no force there"
        )
    if np.ptp(measured[counted]) == 0.0:
        raise RecordingError(f"{name}: measured force is constant; check its topic and field in the signals file")


def _find_speed(runs: Sequence[tuple[F, SampleRun | None]], time_s: F, position: F) -> F:
    """Return a speed [m/s] (n,) for charts: that of the first model, else the slope of the position."""
    for _, run in runs:
        if run is not None:
            return np.append(run.series.speed, np.nan)[run.newest]
    return np.asarray(np.gradient(position, time_s))


def _find_exits(model: ComparedModel, run: SampleRun | None, counted: Mask) -> tuple[RangeUse, ...]:
    if model.model is None or run is None:
        return ()
    ticks = np.unique(run.newest[counted & (run.newest >= 0)])
    return find_outside(model.model, {name: getattr(run.series, name)[ticks] for name in SIGNAL_UNITS})
