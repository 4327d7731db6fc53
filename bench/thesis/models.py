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
from dataclasses import dataclass
from pathlib import Path

from joblib import Memory, Parallel, delayed, parallel_config

from bench.thesis.one_step import one_step_network
from bench.thesis.rows import ANFIS, NETWORK, POLYNOMIAL
from ces_identify.identification import identify
from ces_identify.polynomial.search_limits import BOTH, Limits
from ces_identify.polynomial.search_limits import THESIS as TO_THE_LETTER
from ces_identify.recordings.recording import Recording
from ces_identify.structures.fuzzy import CURRENT_AND_SPEED, FuzzyShape
from ces_identify.structures.kit import Fitter, IdentifyOptions
from ces_identify.structures.network import NetworkShape
from ces_identify.structures.polynomial import fit_polynomial
from ces_identify.trained.training import LagCounts
from ces_observer.errors import CesError
from ces_observer.model import Model
from ces_rig.experiment import Experiment, find_experiment, load_experiment, run, with_seed

ROOT = Path(__file__).resolve().parents[2]
CODE_MODULES = ("ces_observer", "ces_identify", "ces_rig", "bench.thesis.models", "bench.thesis.one_step")
FRESH = 1000  # added to an experiment's seed for the run on which models are evaluated

THESIS, OURS = "thesis", "ours"
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
        how = "its procedure" if self.procedure == THESIS else "ours"
        return f"{self.structure} {self.size}, {how}, from {' + '.join(self.sources)}"


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
    for path in sorted(files | set((ROOT / "ces_rig").rglob("*.yaml"))):
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
    ours = job.procedure == OURS
    terms = job.size[0] if job.structure == POLYNOMIAL else Limits().max_terms
    method = BOTH if ours else TO_THE_LETTER
    limits = Limits(terms, seconds, starts=STARTS[job.structure], threads=1, method=method)
    if job.structure == NETWORK and not ours:
        return one_step_network(LagCounts(*job.size[:3]), job.size[3], recordings, limits)
    options = IdentifyOptions(split=1.0, limits=limits, certify=ours)
    return identify(recordings, (), options, fitter=make_fitter(job)).model


def make_fitter(job: TrainingJob) -> Fitter:
    """Return the fit of a job; ours has the same size, and the lags of the program's defaults."""
    if job.structure == POLYNOMIAL:
        return fit_polynomial
    if job.structure == NETWORK:
        return NetworkShape(units=job.size[3])
    currents, speeds = job.size
    if job.procedure == OURS:
        return FuzzyShape(speeds, currents)
    return FuzzyShape(speeds, currents, current_delay_s=0.0, lags=CURRENT_AND_SPEED)


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
