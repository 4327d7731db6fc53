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

import yaml
from joblib import Memory, Parallel, delayed, parallel_config

from bench.thesis.one_step import one_step_model
from ces_identify.identification import identify
from ces_identify.polynomial.regressors import load_rules, parse_rules
from ces_identify.polynomial.search_limits import BOTH, RANDOM, Limits
from ces_identify.recordings.recording import Recording
from ces_identify.structures.fuzzy import FuzzyShape
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.network import NetworkShape
from ces_identify.structures.polynomial import fit_polynomial
from ces_identify.validation.evaluate import Evaluation
from ces_observer.errors import CesError
from ces_observer.model import Model
from ces_rig.experiment import Experiment, find_experiment, load_experiment, run, with_seed

ROOT = Path(__file__).resolve().parents[2]
CODE_MODULES = ("ces_observer", "ces_identify", "ces_rig", "bench.thesis.models", "bench.thesis.one_step")
FRESH = 1000  # added to an experiment's seed for the run on which models are evaluated

POLYNOMIAL, NETWORK, ANFIS = "polynomial", "sigmoid", "anfis"
THESIS, OURS = "thesis", "ours"
BY_THESIS = {POLYNOMIAL: "its procedure", NETWORK: "one-step training", ANFIS: "one-step training"}
TERMS = 11  # largest number in a polynomial of table 5.1
POLYNOMIAL_STARTS, TRAINED_STARTS = 24, 8
SEVERAL = 4  # times the seconds of search for a model from several experiments


@dataclass(frozen=True)
class ThesisRow:
    """A row of the thesis' tables: its name, and the experiments for identification and evaluation."""

    title: str
    source: str
    target: str


ROWS = (
    ThesisRow("4 Hz sine", "sine_4hz", "sine_4hz"),
    ThesisRow("sweep 2-16 Hz", "sweep", "sweep"),
    ThesisRow("low-pass noise", "noise", "noise"),
    ThesisRow("4 Hz sine on the sweep model", "sweep", "sine_4hz"),
    ThesisRow("4 Hz sine on the noise model", "noise", "sine_4hz"),
)


BY_LAGS = """\
# Candidates of the thesis' procedure: lagged inputs and current, without a valve lag.
force:
  lags: [1, 2]
  speed: {lags: [0], powers: [0.5, 1.0, 1.5], forms: [signed, magnitude]}
  current: {lags: [8], powers: [1.0, 2.0], forms: [magnitude]}
speed: {lags_ms: [0, 3, 8], powers: [0.5, 1.0, 2.0], forms: [signed, magnitude]}
current: {lags_ms: [0, 8, 16], powers: [1.0, 2.0], forms: [magnitude]}
position: {lags: [0], powers: [1.0, 2.0], forms: [signed]}
products:
  - []
  - [speed]
  - [current]
  - [position]
  - [speed, current]
  - [position, current]
  - [force]
  - [force, speed]
  - [force, current]
  - [force, speed, current]
"""


@dataclass(frozen=True)
class TrainingJob:
    """A model to train: structure, procedure, experiments, and for a polynomial the maximum number of terms."""

    structure: str
    procedure: str
    sources: tuple[str, ...]
    terms: int = TERMS

    def limit_s(self, seconds: float) -> float:
        """Return the time limit [s] of this search, if one on a single experiment may take `seconds`."""
        return seconds * (SEVERAL if len(self.sources) > 1 else 1)

    def __str__(self) -> str:
        size = f" of at most {self.terms} terms" if self.structure == POLYNOMIAL else ""
        how = OURS if self.procedure == OURS else BY_THESIS[self.structure]
        return f"{self.structure}{size}, {how}, from {' + '.join(self.sources)}"


@dataclass(frozen=True)
class TrainingOutcome:
    """The outcome of a job: its model, or why there is none, and the time [s]."""

    model: Model | None
    why_none: str
    seconds: float


Evaluations = dict[
    tuple[str, str, ThesisRow], Evaluation | None
]  # by structure, procedure and row; None where there is no model


def load_named_experiment(name: str, fresh: bool) -> Experiment:
    """Return a packaged experiment, with another seed if `fresh`."""
    experiment = load_experiment(find_experiment(name))
    return with_seed(experiment, experiment.settings.seed + FRESH) if fresh else experiment


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
    starts = POLYNOMIAL_STARTS if job.structure == POLYNOMIAL else TRAINED_STARTS
    ours = job.procedure == OURS
    limits = Limits(job.terms, seconds, starts=starts, threads=1, method=BOTH if ours else RANDOM)
    if job.structure != POLYNOMIAL and not ours:
        return one_step_model(job.structure, recordings, limits)
    fitter = {POLYNOMIAL: fit_polynomial, NETWORK: NetworkShape(), ANFIS: FuzzyShape()}[job.structure]
    rules = load_rules(None) if ours else parse_rules(yaml.safe_load(BY_LAGS), "candidates by lags")
    options = IdentifyOptions(split=1.0, rules=rules, limits=limits, certify=ours)
    return identify(recordings, (), options, fitter=fitter).model


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
