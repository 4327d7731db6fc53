"""The models of the thesis' tables: their list, their training, and a store of trained models.

`train_jobs` trains each `TrainingJob` in parallel processes and stores the outcome on disk by job, limits and digest of
the packages' code: a rerun uses stored outcomes, an interrupted run continues, and a change of the code invalidates
them.
"""

from __future__ import annotations

import hashlib
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from joblib import Memory, Parallel, delayed, parallel_config

from bench.thesis.one_step import fit_conventionally
from bench.thesis.rows import ANFIS, NETWORK, POLYNOMIAL
from ces_identify.identification import identify
from ces_identify.polynomial.regressors import load_rules
from ces_identify.polynomial.search_limits import BOTH, Limits
from ces_identify.polynomial.search_limits import THESIS as TO_THE_LETTER
from ces_identify.recordings.recording import Recording
from ces_identify.structures.fuzzy import CURRENT_AND_SPEED, FuzzyShape
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.network import NetworkShape
from ces_identify.trained.training import LagCounts
from ces_observer.errors import CesError
from ces_observer.model import Model
from ces_rig.experiment import Experiment, find_experiment, load_experiment, run, with_seed

ROOT = Path(__file__).resolve().parents[2]
CODE_MODULES = ("ces_observer", "ces_identify", "ces_rig", "bench.thesis.models", "bench.thesis.one_step")
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
    print(f"{len(jobs)} models, {processes} in parallel, at most {seconds:g} s of search each", flush=True)
    for job, outcome in train_jobs(jobs, seconds, processes, store):
        outcomes[job] = outcome
        size = outcome.model.size if outcome.model else outcome.why_none
        print(f"[{len(outcomes):2}/{len(jobs)}] {outcome.seconds:4.0f} s  {job}: {size}", flush=True)
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
        limits = Limits(seconds=seconds, starts=starts, threads=1)
        shape = make_shape(job)
        if not ours:
            return fit_conventionally(shape, recordings, limits)
        return identify(recordings, (), IdentifyOptions(split=1.0, limits=limits), fitter=shape).model
    limits = Limits(job.size[0], seconds, starts=starts, threads=1, method=BOTH if ours else TO_THE_LETTER)
    options = IdentifyOptions(split=1.0, limits=limits, certify=ours)
    if job.procedure == PUBLISHED:  # the search has no candidates beyond the initial model
        rules = load_rules(REGRESSORS / f"{Path(job.sources[0]).name}.yaml")
        options = replace(options, rules=rules, rate_Hz=REGRESSORS_HZ)
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
