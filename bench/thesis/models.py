"""The rows of the thesis' tables, the training of their models, and a store of trained models.

J. Söderberg, *Black-box modeling of a semi-active motorcycle damper*, KTH 2011 (XR-EE-RT 2011:001), chapter 5.
Experiments are named as in `ces_rig/experiments/thesis/`. `train_jobs` trains each `TrainingJob` in parallel processes
and stores the outcome on disk by job, limits and digest of the packages' code: a rerun uses stored outcomes, an
interrupted run continues, and a change of the code invalidates them.
"""

from __future__ import annotations

import hashlib
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from joblib import Memory, Parallel, delayed, parallel_config
from numpy.typing import NDArray

from bench.measurement import print_note
from ces_data.recording import Recording
from ces_identify.identification import identify
from ces_identify.numerics.least_squares import NormalEquations
from ces_identify.numerics.search import GAUSS_NEWTON, Limits
from ces_identify.numerics.search import THESIS as TO_THE_LETTER
from ces_identify.polynomial.rules_file import load_rules
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.prepare.series import prepare
from ces_identify.structures.fuzzy import CURRENT_AND_SPEED, FuzzyShape
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.lagged import train
from ces_identify.structures.network import NetworkFit, NetworkShape
from ces_identify.training import LagCounts, RegressorTable, build_training, with_measured_past
from ces_observer.errors import CesError
from ces_observer.model import Model
from ces_rig.experiments.virtual import Experiment, find_experiment, load_experiment, run, with_seed

POLYNOMIAL, NETWORK, ANFIS = "polynomial", "sigmoid", "anfis"


@dataclass(frozen=True)
class ThesisRow:
    """A row: the experiments for identification and evaluation, the model's size and the cost J [%].

    The size is the number of regressors; Y, C, V and neurons; or the memberships A x B of current and speed. `cost` is
    None where the thesis has "-" because the model was unstable.
    """

    title: str
    source: str
    target: str
    size: tuple[int, ...]
    cost: float | None


@dataclass(frozen=True)
class ThesisTable:
    """A table: its number, title, and what its column of sizes holds."""

    number: str
    title: str
    size: str
    rows: tuple[ThesisRow, ...]


TABLES = {
    POLYNOMIAL: ThesisTable(
        "5.1",
        "polynomial NARX",
        "regressors",
        (
            ThesisRow("Sine 4 Hz", "sine_4hz", "sine_4hz", (7,), 2.34),
            ThesisRow("Sine 12 Hz", "sine_12hz", "sine_12hz", (10,), 1.77),
            ThesisRow("Sine 16 Hz", "sine_16hz", "sine_16hz", (11,), 1.63),
            ThesisRow("LP filtered white noise", "noise", "noise", (9,), 14.79),
            ThesisRow("Sweep 2-16 Hz", "sweep", "sweep", (5,), 6.92),
            ThesisRow("Sine 4 Hz on the sweep model", "sweep", "sine_4hz", (5,), 63.79),
            ThesisRow("Sine 4 Hz on the white noise model", "noise", "sine_4hz", (9,), 136.24),
        ),
    ),
    NETWORK: ThesisTable(
        "5.2",
        "sigmoid network NARX",
        "Y, C, V; neurons",
        (
            ThesisRow("Sine 4 Hz", "sine_4hz", "sine_4hz", (2, 2, 2, 15), 1.24),
            ThesisRow("Sweep 2-16 Hz", "sweep", "sweep", (2, 2, 2, 20), 2.72),
            ThesisRow("Sine 4 Hz on the sweep model", "sweep", "sine_4hz", (2, 2, 2, 20), 22.02),
            ThesisRow("LP filtered white noise", "noise", "noise", (2, 3, 3, 16), 11.24),
            ThesisRow("LP filtered white noise", "noise", "noise", (2, 4, 5, 30), 9.86),
            ThesisRow("Sine 4 Hz on the white noise model", "noise", "sine_4hz", (2, 4, 5, 30), 38.87),
        ),
    ),
    ANFIS: ThesisTable(
        "5.3",
        "neuro-fuzzy (ANFIS)",
        "A x B",
        (
            ThesisRow("Sine 4 Hz", "sine_4hz", "sine_4hz", (4, 4), 2.12),
            ThesisRow("Sine 16 Hz", "sine_16hz", "sine_16hz", (4, 4), 3.38),
            ThesisRow("Sweep 2-16 Hz", "sweep", "sweep", (3, 3), 6.6),
            ThesisRow("Sweep 2-16 Hz", "sweep", "sweep", (6, 6), 5.2),
            ThesisRow("Sine 16 Hz on the sine 4 Hz model", "sine_4hz", "sine_16hz", (4, 4), None),
        ),
    ),
}


def format_size(row: ThesisRow) -> str:
    """Return the size as the thesis prints it."""
    if len(row.size) == 4:
        return "{}, {}, {}; {}".format(*row.size)
    return " x ".join(map(str, row.size))


F = NDArray[np.float64]


class OneStepNetwork(NetworkFit):
    """A sigmoid network trained on the error one step ahead (series-parallel), as MATLAB's `nlarx` does by default.

    Measured past forces replace the model's own, which makes the fit an ordinary nonlinear least-squares problem but
    does not control the free run; the same holds for a polynomial's least squares.
    """

    @cached_property
    def measured_table(self) -> RegressorTable:
        """The regressors, past forces among them as measured."""
        return with_measured_past(self.table, self.training)

    def equations(self, params: F, max_error: float) -> NormalEquations:
        """Return the normal equations of the one-step error."""
        return self.normal_equations(self.measured_table, params, max_error)


def fit_conventionally(shape: NetworkShape | FuzzyShape, recordings: Sequence[Recording], limits: Limits) -> Model:
    """Return a model of this shape trained the conventional way, without a proof or a bound on the force.

    Neuro-fuzzy models of present inputs have no past forces, and so only one kind of error. Parameters are selected by
    free run on the selection ticks, as in the thesis for polynomials. Raises CesError if every start's free run
    diverged.
    """
    sampling = choose_sampling(recordings)
    data = build_training([prepare(recording, sampling) for recording in recordings])
    family = shape.family(replace(data, force_envelope=data.loose), sampling.rate_Hz)
    if isinstance(family, NetworkFit):
        family = OneStepNetwork(*(getattr(family, f.name) for f in fields(family)))
    results = train(family, limits, certificate=False)
    if not results:
        raise CesError(f"every free run of {shape.option} models diverged")
    return family.model(results[0].coefficients, sampling)


ROOT = Path(__file__).resolve().parents[2]
CODE_MODULES = ("ces_observer", "ces_identify", "ces_rig", "bench.thesis.models")
FRESH = 1000  # added to an experiment's seed for the run on which models are evaluated

THESIS, OURS, PUBLISHED = "thesis", "ours", "published"
NAMES = {THESIS: "its procedure here", OURS: "ours", PUBLISHED: "its regressors here"}
REGRESSORS = ROOT / "config" / "thesis"  # files of the published regressors
REGRESSORS_HZ = 250.0  # of 1000, 500 and 250 Hz the only rate at which all of them give a stable model
STARTS = {POLYNOMIAL: 24, NETWORK: 4, ANFIS: 4}
SEVERAL = 4  # times the seconds of search for a model from several experiments


@dataclass(frozen=True)
class TrainingJob:
    """A model to train: structure, procedure, experiments, and size (see `ThesisRow`; for a polynomial, at most)."""

    structure: str
    procedure: str
    sources: tuple[str, ...]
    size: tuple[int, ...]

    def limit_s(self, seconds: float) -> float:
        """Return the time limit [s] of this search, if one on a single experiment may take `seconds`."""
        return seconds * (SEVERAL if len(self.sources) > 1 else 1)

    def __str__(self) -> str:
        return f"{self.structure} {self.size}, {NAMES[self.procedure]}, from {' + '.join(self.sources)}"


@dataclass(frozen=True)
class TrainingOutcome:
    """The outcome of a job: its model, or why there is none, and the time [s]."""

    model: Model | None
    why_none: str
    seconds: float


def load_named_experiment(name: str, fresh: bool) -> Experiment:
    """Return a packaged experiment, with another seed if `fresh`."""
    experiment = load_experiment(find_experiment(name))
    return with_seed(experiment, experiment.settings.seed + FRESH) if fresh else experiment


def train_all(
    jobs: Sequence[TrainingJob], seconds: float, processes: int, store: Path
) -> dict[TrainingJob, TrainingOutcome]:
    """Return the outcome of every job and print each; stored ones come first."""
    outcomes: dict[TrainingJob, TrainingOutcome] = {}
    print(
        f"{len(jobs)} models, {processes} in parallel, at most {seconds:g} s of search each",
        file=sys.stderr,
        flush=True,
    )
    for job, outcome in train_jobs(jobs, seconds, processes, store):
        outcomes[job] = outcome
        size = outcome.model.size if outcome.model else outcome.why_none
        print_note(f"[{len(outcomes):2}/{len(jobs)}] {outcome.seconds:4.0f} s  {job}: {size}")
    return outcomes


def train_jobs(
    jobs: Sequence[TrainingJob], seconds: float, processes: int, store: Path
) -> Iterator[tuple[TrainingJob, TrainingOutcome]]:
    """Yield each job with its outcome when ready; `seconds` limits a search on one experiment."""
    code = code_digest()
    with parallel_config("loky", n_jobs=processes, inner_max_num_threads=1):
        work = Parallel(return_as="generator_unordered")
        yield from work(delayed(_load_or_train)(job, seconds, code, store) for job in jobs)


def code_digest() -> str:
    """Return a digest of the code: the loaded modules among CODE_MODULES, and the rig's descriptions."""
    files = {
        Path(m.__file__) for n, m in sys.modules.items() if {n, n.partition(".")[0]} & {*CODE_MODULES} and m.__file__
    }
    digest = hashlib.sha256()
    for path in sorted(files | set((ROOT / "ces_rig").rglob("*.yaml")) | set(REGRESSORS.glob("*.yaml"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _load_or_train(job: TrainingJob, seconds: float, code: str, store: Path) -> tuple[TrainingJob, TrainingOutcome]:
    """Return the outcome, stored or new; Ctrl-C ends the process at once, so that no partial search is stored."""
    handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        return job, Memory(store, verbose=0).cache(train_job)(job, job.limit_s(seconds), code)
    finally:
        signal.signal(signal.SIGINT, handler)


def train_job(job: TrainingJob, seconds: float, code: str) -> TrainingOutcome:
    """Train `job` on first runs of its experiments for at most `seconds`; `code` identifies the version."""
    del code
    recordings = [run(load_named_experiment(name, fresh=False)) for name in job.sources]
    began = time.monotonic()
    try:
        return TrainingOutcome(_train(job, recordings, seconds), "", time.monotonic() - began)
    except CesError as error:
        return TrainingOutcome(None, str(error), time.monotonic() - began)


def _train(job: TrainingJob, recordings: Sequence[Recording], seconds: float) -> Model:
    ours, starts = job.procedure == OURS, STARTS[job.structure]
    if job.structure != POLYNOMIAL:
        limits = Limits(time=seconds, starts=starts, threads=1)
        shape = make_shape(job)
        if not ours:
            return fit_conventionally(shape, recordings, limits)
        return identify(recordings, (), IdentifyOptions(split=1.0, limits=limits), fitter=shape).model
    limits = Limits(job.size[0], seconds, starts=starts, threads=1, method=GAUSS_NEWTON if ours else TO_THE_LETTER)
    options = IdentifyOptions(split=1.0, limits=limits, certificate=ours)
    if job.procedure == PUBLISHED:  # the search has no candidates beyond the initial model
        rules = load_rules(REGRESSORS / f"{Path(job.sources[0]).name}.yaml")
        options = replace(options, candidates=rules, rate=REGRESSORS_HZ)
    return identify(recordings, (), options).model


def make_shape(job: TrainingJob) -> NetworkShape | FuzzyShape:
    """Return the shape of a network or of rules: the inputs of the thesis, or for ours those of the defaults."""
    ours = job.procedure == OURS
    if job.structure == NETWORK:
        *counts, units = job.size
        return NetworkShape(units) if ours else NetworkShape(units, LagCounts(*counts))
    currents, speeds = job.size
    if ours:
        return FuzzyShape(speeds, currents)
    return FuzzyShape(speeds, currents, current_delay_s=0.0, lags=CURRENT_AND_SPEED)


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
