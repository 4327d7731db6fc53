"""The loop: design an experiment, have it run, score the model on it, identify anew, until a rule says stop.

A search of its own ends early at Ctrl-C and keeps its best model; here the program stops.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, BinaryIO

import numpy as np

from ces_data.arrays import F
from ces_data.bags.reader import read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.checks.check import require_consistent
from ces_data.checks.content import require_distinct, shared_content
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_identify.identification import cross_fit
from ces_identify.jobs import append_row, open_rows, read_rows
from ces_identify.numerics.search import INTERRUPTED, Listener, SearchResult
from ces_identify.polynomial.free_run_fit import fit_free_run
from ces_identify.polynomial.problem import Problem, assemble_problem
from ces_identify.prepare.series import Series, prepare
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions
from ces_identify.validation.evaluate import VALIDATION, Evaluation, cost_interval, evaluate, pooled_cost
from ces_observer.model import Model, Sampling
from ces_observer.structures.polynomial import Polynomial, Term
from ces_rig.errors import RigError
from ces_rig.experiments.commands import INTERVAL_S, NEED, RigCommands, read_commands
from ces_rig.experiments.designer import (
    DesignTask,
    design_experiment,
    make_power_model,
    plan_rest,
    recorded_commands,
    recorded_power,
    rows_of,
)
from ces_rig.experiments.information import (
    Features,
    Information,
    Knowledge,
    Pool,
    compare_models,
    draw_features,
    draw_pool,
    find_least_known,
)
from ces_rig.loop.rigs import REPEATED, IdentifyPlan, Plan, RigAdapter
from ces_rig.loop.store import MODEL, RECORDING, ROWS, Iteration, Step, keep_inputs

REFIT_STEPS = 20
REFITTED = "parameters of the model before, improved"


def identify_all(
    recordings: Sequence[Recording], plan: IdentifyPlan, seed: int, listener: Listener, previous: Model | None = None
) -> tuple[Model, tuple[Model, ...], float]:
    """Identify a model on all recordings; with `previous`, improve its parameters only, if its structure allows that.

    Returns the model, those that have not seen all recordings, and its cost J [%] on all recordings together.
    Raises CesError if the recordings contradict each other or hold too little; Ctrl-C leaves no model.
    """
    require_consistent(recordings)
    request = plan.request(seed)
    options, fitter = request.options(), request.fitter()
    if previous is not None and isinstance(previous.body, Polynomial):
        options, fitter = replace(options, rate=previous.sampling.rate_Hz), refitter(previous)
    with interruptible():
        crossed = cross_fit(recordings, options, listener, fitter)
    if any(search.ended == INTERRUPTED for search in crossed.result.search_results):
        raise KeyboardInterrupt  # a search with a handler of its own for Ctrl-C ends early instead
    return crossed.result.model, crossed.models, pooled_cost(crossed.result.evaluations)


def evaluate_fresh(model: Model, recording: Recording) -> Evaluation:
    """Return the free run of a model on a recording that it has not seen."""
    return evaluate(model, [prepare(recording, model.sampling)], VALIDATION)[0]


def score_fresh(model: Model, recording: Recording) -> dict[str, float | None]:
    """Return the cost [%] of a model on a recording that it has not seen, and the upper end of its 95 % interval."""
    evaluation = evaluate_fresh(model, recording)
    interval = cost_interval([evaluation])
    return {"fresh_J": evaluation.cost, "fresh_high_J": None if interval is None else interval.high}


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt after the block if Ctrl-C came inside it, even if the block caught the exception.

    Only the main thread of a program that does not ignore Ctrl-C can notice it.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before in (signal.SIG_IGN, None):
        yield
        return
    came: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        came.append(number)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        raise KeyboardInterrupt


def refitter(previous: Model) -> Fitter:
    """Return a fitter that improves the coefficients of the polynomial `previous` on new data and keeps its terms."""

    def fit(series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener) -> Fitted:
        problem = assemble_problem(series, _terms(previous), options.certificate, options.weight)
        old = Model(sampling, previous.body, problem.envelope, problem.force_envelope)
        better = _improve(problem, old, np.ones(len(problem.everything)))
        model = better if better is not None and better.is_stable() else old
        coefficients = np.array([term.coefficient for term in _terms(model)])
        terms = np.arange(len(coefficients))
        cost = problem.selection_cost(terms, coefficients)
        result = SearchResult(terms, coefficients, cost, options.limits.seed, 1, "improved")
        listener(result)
        certified = replace(model, certificate=model.certify().to_mapping())
        return Fitted(certified, [result], {"method": REFITTED}, partial(_improve, problem, certified))

    return fit


def _improve(problem: Problem, model: Model, weights: F) -> Model | None:
    """Return the model with coefficients fitted to the weighted ticks; None if its free run diverges."""
    terms = _terms(model)
    start = np.array([term.coefficient for term in terms])
    fit = fit_free_run(problem, np.arange(len(terms)), start, weights * problem.everything, REFIT_STEPS)
    changed = [replace(t, coefficient=float(c)) for t, c in zip(terms, fit.coefficients, strict=True)]
    return replace(model, body=Polynomial(tuple(changed))) if np.isfinite(fit.error) else None


def _terms(model: Model) -> tuple[Term, ...]:
    assert isinstance(model.body, Polynomial)
    return model.body.terms


SEEDS = 10_000  # the seeds of two plans are this far apart


class IterateListener:
    """Ignores the progress of an iteration; subclasses show it. A search calls `listen_search` from any thread."""

    def resume(self, history: Sequence[Iteration]) -> None:
        """Receive the iterations of an earlier run, if there are any."""

    def begin(self, number: int, step: str) -> None:
        """Receive the number of the iteration and the step that begins."""

    def listen_search(self, news: SearchResult | str) -> None:
        """Receive an improvement of the search."""

    def finish(self, iteration: Iteration) -> None:
        """Receive a finished iteration."""


def find_stop(plan: Plan, history: Sequence[Iteration], next_s: float) -> str:
    """Return which rule of the plan says stop before an experiment of `next_s` seconds; nothing if none does."""
    stop = plan.stop
    newest = history[-1] if history else None
    if newest is not None and newest.fresh_high_J is not None and newest.fresh_high_J <= stop.target_J:
        cost = f"J {newest.fresh_J:.2f} %, with 95 % confidence at most {newest.fresh_high_J:.2f} %"
        return f"target reached: {cost}, on the newest recording before it was used"
    tried = sum(iteration.number > 0 for iteration in history)
    if tried >= stop.max_iterations:
        return f"{tried} iterations, the most that the plan allows"
    costs = [iteration.fresh_J for iteration in history if iteration.fresh_J is not None]  # on fresh repetitions
    if plan.experiments.kind == REPEATED and len(costs) > 1 and costs[-1] > (1.0 - stop.fall) * min(costs[:-1]):
        return f"the cost has stopped falling (by less than {100.0 * stop.fall:.2g} %)"
    spent = history[-1].total_s if history else 0.0
    if spent + next_s > stop.budget_s * (1.0 + 1e-9):
        return f"budget spent: {spent:.1f} of {stop.budget_s:g} s recorded, the next experiment takes {next_s:.1f} s"
    return ""


@dataclass
class IterationProgress:
    """What the iterations so far have left: their lines, recordings, and the newest model with its ensemble."""

    history: list[Iteration] = field(default_factory=list)
    recordings: list[Recording] = field(default_factory=list)
    model: Model | None = None
    ensemble: Sequence[Model] = ()

    @property
    def recorded_s(self) -> float:
        """Seconds that the rig recorded."""
        return self.history[-1].total_s if self.history else 0.0

    @property
    def load_W(self) -> float:
        """Heat load after the last experiment [W]."""
        return self.history[-1].load_W if self.history else 0.0


class Iterations:
    """An iteration of `plan` on `rig` in the folder `out`; raises CesError for files that cannot be used."""

    def __init__(self, plan: Plan, rig: RigAdapter, out: Path, listener: IterateListener | None = None) -> None:
        self.plan, self.rig, self.out = plan, rig, out
        self.listener = listener or IterateListener()
        self.pool: Pool = draw_pool(plan.limits, plan.seed)
        self.features: Features = draw_features(plan.seed)
        self.targets = self.features.at(self.pool.state)
        self.given, self.validation = (
            [read_recording(plan.path(text), load_signals(), NEED) for text in paths]
            for paths in (plan.recordings, plan.validate)
        )
        require_distinct(self.given, self.validation)
        repeated = plan.experiments.commands
        self._repeated = plan.limits.require_within(read_commands(plan.path(repeated))) if repeated else None
        self.done = IterationProgress()

    def run(self, when_open: Callable[[], None] = lambda: None) -> str:
        """Go on from where the folder is until a rule says stop; returns why it stopped. Raises CesError.

        `when_open` is called once the folder is locked against a second run.
        """
        with open_rows(self.out / ROWS) as file:
            when_open()
            keep_inputs(self.out, self.plan, self.given)
            rows = read_rows(file, self.out / ROWS, "an iteration")
            self._restore([Iteration.from_row(row, self.out / ROWS) for row in rows.values()])
            if self.done.history:
                self.listener.resume(self.done.history)
            elif self.given:
                self.listener.begin(0, "identifying the given recordings")
                nothing = dict.fromkeys(("recorded_s", "total_s", "rest_s", "load_W"), 0.0)
                given = {"name": "given", **nothing, "fresh_J": None}
                self._keep(file, self._identify(Step.open(self.out, 0), given))
            while True:
                next_s = self._repeated.duration_s if self._repeated else self.plan.experiments.duration_s
                if reason := find_stop(self.plan, self.done.history, next_s):
                    return reason
                self._keep(file, self._iterate())

    def _keep(self, file: BinaryIO, iteration: Iteration) -> None:
        append_row(file, iteration.to_row())  # before the listener, which may write pages on a full disk
        self.done.history.append(iteration)
        self.listener.finish(iteration)

    def knowledge(self) -> Knowledge:
        """Return what the newest models do not know."""
        if self.done.model is None:
            return Knowledge(np.ones(len(self.targets)), np.zeros(len(self.targets)))
        return compare_models(self.done.model, self.done.ensemble, self.pool)

    def information(self) -> Information:
        """Return what all recordings say about the states within the limits."""
        information = Information.none(self.targets.shape[1])
        for recording in (*self.given, *self.done.recordings):
            made = recorded_commands(recording)
            information = information.add(rows_of(made.stroke_m, made.current_A, self.plan.limits, self.features))
        return information

    def _iterate(self) -> Iteration:
        """Do what the next iteration still lacks, and return it."""
        done, plan = self.done, self.plan
        step = Step.open(self.out, done.history[-1].number + 1 if done.history else 1)
        commands = step.read_commands()
        if commands is None:
            self.listener.begin(step.number, "designing the experiment")
            step.write_commands(self._design(step.number))
            commands = step.read_commands()  # with the file's digits, as after an interruption
            assert commands is not None
        if plan.experiments.kind == REPEATED:
            self._repeated = commands
        plan.limits.require_within(commands)
        recording = self._record(step, commands)
        fresh = {"fresh_J": None} if done.model is None else score_fresh(done.model, recording)
        cooled = done.load_W * float(np.exp(-commands.rest_s / plan.limits.heat.memory_s))
        facts = {
            "name": commands.name,
            "recorded_s": commands.duration_s,
            "total_s": done.recorded_s + commands.duration_s,
            "rest_s": commands.rest_s,
            "load_W": float(plan.limits.heat.load_after(cooled, recorded_power(recording), INTERVAL_S)[-1]),
            **fresh,
        }
        self.listener.begin(step.number, "identifying from all recordings")
        done.recordings.append(recording)
        return self._identify(step, facts)

    def _record(self, step: Step, commands: RigCommands) -> Recording:
        """Return the step's recording, from the rig if it is new."""
        if not (step.folder / RECORDING).exists():
            rest = f" after a rest of {commands.rest_s:.0f} s" if commands.rest_s else ""
            self.listener.begin(step.number, f"running {commands.duration_s:.1f} s on the rig{rest}")
            recording = self.rig.run(commands, step.folder)
            self._require_new(recording, step)
            write_bag(step.folder / RECORDING, recording_topics(recording, load_signals()))
        return step.read_recording(commands.name)

    def _require_new(self, recording: Recording, step: Step) -> None:
        """Raise RigError if it is one that exists already: the score before its fit would be that of known data.

        The virtual rig may repeat itself, if its sensors have no noise.
        """
        seen = [] if self.plan.rig["kind"] == "virtual" else [*self.given, *self.done.recordings]
        for earlier in (*self.validation, *seen):
            if shared := shared_content(earlier, recording):
                raise RigError(
                    f"{step.folder}: the recording from the rig and {earlier.source or earlier.name}: {shared}; an "
                    "experiment needs a new recording: run commands.csv of this folder, then repeat the command"
                )

    def _design(self, number: int) -> RigCommands:
        """Return the next experiment, with the rest that the damper needs before it."""
        rest, load = plan_rest(self.plan.limits.heat, self.done.load_W)
        seed, name = self.plan.seed * SEEDS + number, f"experiment_{number:02d}"
        if self._repeated:
            return self._repeated.repeat(name, seed, rest)
        task = DesignTask(
            self.plan.limits,
            self.features,
            self.information(),
            self.targets,
            self.knowledge().weights(),
            make_power_model(self.done.model, self.plan.limits.heat),
            load,
        )
        return design_experiment(task, name, self.plan.experiments.duration_s, seed).repeat(name, seed, rest)

    def _identify(self, step: Step, facts: dict[str, Any]) -> Iteration:
        """Identify from all recordings, keep the models, and return the iteration."""
        plan, recordings = self.plan, [*self.given, *self.done.recordings]
        previous = self.done.model if plan.experiments.kind == REPEATED else None
        listen, done = self.listener.listen_search, self.done
        model, ensemble, fit_J = identify_all(recordings, plan.identify, plan.seed, listen, previous)
        step.write_models(model, ensemble)
        done.model, done.ensemble = step.read_models()
        knowledge, information = self.knowledge(), self.information()
        variance = information.variance(self.targets)
        regions = find_least_known(self.pool, knowledge.weights() * variance, variance)
        return Iteration(
            number=step.number,
            fit_J=fit_J,
            validation_J={r.name: evaluate_fresh(done.model, r).cost for r in self.validation},
            coverage=information.coverage(self.targets),
            disagreement=float(np.sqrt(np.mean(knowledge.disagreement**2))),
            band=float(np.sqrt(np.mean(knowledge.band**2))),
            regions=regions,
            model=str((step.folder / MODEL).relative_to(self.out)),
            **facts,
        )

    def _restore(self, history: list[Iteration]) -> None:
        """Read again what finished iterations have left."""
        steps = [(iteration, Step.open(self.out, iteration.number)) for iteration in history]
        recordings = [step.read_recording(iteration.name) for iteration, step in steps if iteration.number > 0]
        self.done = IterationProgress(history, recordings)
        if steps:
            self.done.model, self.done.ensemble = steps[-1][1].read_models()
        if self.plan.experiments.kind == REPEATED and recordings:
            self._repeated = steps[-1][1].read_commands()
