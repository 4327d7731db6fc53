"""A simulation that is an identified model, and its error on recordings that it was not fitted to.

A model identified inside the diagnosis is fitted to all references. What it misses on them would understate its error,
as it has seen them: models that were fitted without each of them give the error that the diagnosis counts with.
A model file says by its band what it left on data that no choice had used.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import NormalDist

import numpy as np

from ces_data.arrays import F
from ces_data.reading import RecordingInputs, as_recordings
from ces_data.recording import Recording
from ces_gap.errors import GapError
from ces_gap.grid import rms
from ces_gap.limits import EvidenceLimits
from ces_gap.progress import Progress, ignore_progress
from ces_gap.trace import Trace, resample_to_grid
from ces_identify.identification import cross_fit
from ces_identify.numerics.search import Limits, SearchResult
from ces_identify.simulations.simulate import sample_force, sample_run
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.structures.auto import AUTO, BestStructure, default_sizes, select_fitter
from ces_identify.structures.kit import Fitter, IdentifyOptions
from ces_identify.validation.band import band_half_width
from ces_observer.model import Model

MODEL = "model.json"
STARTS = 2  # of a fit


@dataclass(frozen=True)
class BlindPart:
    """A part of a reference, from `start_s` to `stop_s` after its first position sample, and a model not fitted to it.

    `key` identifies the reference (`identify_recording`).
    """

    key: str
    start_s: float
    stop_s: float
    model: Model


@dataclass(frozen=True)
class IdentifiedBaseline(Simulation):
    """A model of the references as a simulation; `parts` hold models that have not seen a part of them."""

    model: Model
    parts: tuple[BlindPart, ...]
    name: str = "identified model"

    @property
    def innermost(self) -> Simulation:
        """The simulation by the model."""
        return ModelSimulation(self.model)

    def force(self, recording: Recording) -> F:
        """Return the force [N] of the model at every position sample."""
        return sample_force(self.model, recording)

    def left_out_force(self, recording: Recording) -> F | None:
        """Return the force [N] at every position sample by models that have not seen it, None for other recordings.

        It is the force of the model itself in parts for which there is no other model.
        """
        parts = [part for part in self.parts if part.key == identify_recording(recording)]
        if not parts:
            return None
        stamps, force = recording.channel("position").stamps_ns, self.force(recording)
        seconds = (stamps - stamps[0]) * 1e-9
        for part in parts:
            inside = (seconds >= part.start_s) & (seconds < part.stop_s)
            force = np.where(inside, sample_force(part.model, recording), force)
        return force

    def save(self, path: str | Path) -> IdentifiedBaseline:
        """Write the model file and return the baseline under its path, which `augmented.json` will name."""
        self.model.save(path)
        return replace(self, name=str(path))


def identify_baseline(
    reference: RecordingInputs,
    *,
    structure: str = AUTO,
    threads: int = 1,
    progress: Progress = ignore_progress,
) -> IdentifiedBaseline:
    """Return the most accurate model of the `reference` recordings, to be diagnosed as the simulation.

    `auto` takes the structure with the lowest cost on held-out parts of them. Pass the same references to `diagnose`:
    it then counts with the error of models that have not seen them. Save it before the results, so that
    `augmented.json` names its file. Raises GapError without references, CesError if they hold too little.

        baseline = identify_baseline([new]).save("gap/model.json")
        ces.diagnose(baseline, [worn], reference=[new], out="gap")
    """
    references = as_recordings(reference, required=False)
    if not references:
        raise GapError("a baseline cannot be identified without references; pass recordings free of the effect")
    limits = Limits(starts=STARTS, threads=threads)

    def listen(news: SearchResult | str) -> None:
        text = news if isinstance(news, str) else f"cost J = {news.cost:.2f} %"
        progress(f"identifying a model of the references: {text}", 0.0)

    sizes = default_sizes()
    fitter: Fitter = BestStructure(sizes) if structure == AUTO else select_fitter(structure, sizes)
    fit = cross_fit(references, IdentifyOptions(limits=limits, band=False), listen, fitter)
    keys = [identify_recording(recording) for recording in references]
    parts = tuple(BlindPart(keys[p.recording], p.start_s, p.stop_s, p.model) for p in fit.parts)
    return IdentifiedBaseline(fit.result.model, parts)


def add_left_out_force(simulation: Simulation, trace: Trace) -> Trace:
    """Return a reference's trace with the force by models that have not seen it, if the simulation has such models."""
    if not isinstance(simulation, IdentifiedBaseline):
        return trace
    force = simulation.left_out_force(trace.recording)
    return trace if force is None else replace(trace, simulated_left_out=resample_to_grid(trace, force))


def add_own_error(simulation: Simulation, trace: Trace) -> Trace:
    """Return a trace with the RMS error that the simulation may have on it, if it is a model with a band."""
    model = simulation.innermost.model if isinstance(simulation.innermost, ModelSimulation) else None
    if model is None or model.band is None:
        return trace
    run = sample_run(model, trace.recording)
    width = band_half_width(model.band, run.series, run.run.force)[run.newest]
    half_N = rms(resample_to_grid(trace, np.where(run.newest < 0, np.nan, width))[trace.usable])
    return replace(
        trace, own_error_N=EvidenceLimits.UNSEEN * half_N / NormalDist().inv_cdf(0.5 + 0.5 * model.band.level)
    )


def identify_recording(recording: Recording) -> str:
    """Return a text that identifies the recording, smoothed or not: its hash, or that of its force."""
    return recording.sha256 or hashlib.sha256(recording.channel("force").values.tobytes()).hexdigest()
