"""A campaign: observer, source and monitor run side by side; faults are injected at random times and evaluated."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

from actions import ACTIONS, MAX_AGE_S, Stage
from faults import REAL, Fault
from judge import REPORT_WITHIN_NS, EpisodeLimits, FaultEpisode, FaultOutcome, evaluate_episode
from observer_monitor import MODEL_TOPIC, ObserverMonitor
from processes import ObserverProcess, SourceProcess
from ride import TrueForce

from ces_observer.model import Model

WELL_WITHIN_S = 10.0
SIMULATED_START_NS = 1_000_000_000_000


class ObserverEndedError(Exception):
    """The observer ended during a campaign."""


@contextmanager
def start_stage(model: Model, folder: Path, times: str, namespace: str = "/faults") -> Iterator[Stage]:
    """Start all processes; `folder` receives model files and log. `ObserverProcess.end` must end the observer."""
    path = folder / "model.json"
    model.save(path)
    simulated = times != REAL
    parameters = {
        "model": path,
        "model_topic": MODEL_TOPIC,
        "max_age_s": MAX_AGE_S,
        "use_sim_time": str(simulated).lower(),
    }
    with ObserverMonitor(namespace) as monitor:
        observer = ObserverProcess(namespace, parameters, folder / "observer.log")
        try:
            source = SourceProcess(namespace, SIMULATED_START_NS if simulated else None)
            try:
                yield Stage(observer, source, monitor, model, path)
            finally:
                source.kill()
        finally:
            if observer.is_running():
                observer.process.kill()
                observer.process.wait()


def make_limits(model: Model, times: str) -> EpisodeLimits:
    truth = TrueForce(model)
    return EpisodeLimits(
        model.force_envelope_N,
        truth.force,
        truth.max_force_N,
        model.sampling.warm_up_s,
        MAX_AGE_S if times == REAL else 0.0,
    )


def play(stage: Stage, faults: Iterable[Fault], rules: EpisodeLimits, dice: Random) -> Iterator[FaultOutcome]:
    """Inject the faults one by one and yield the outcome of each. Raises ObserverEndedError."""
    for fault in faults:
        well = wait_until_well(stage)
        time.sleep(dice.uniform(0.1, 0.8))
        episode = inject_fault(stage, fault, dice)
        if not well:
            episode.wrong.append(f"the observer had not recovered {WELL_WITHIN_S:g} s after the previous fault")
        time.sleep(max(0.0, (episode.good_at + REPORT_WITHIN_NS - time.time_ns()) * 1e-9 + 0.05))
        if not stage.observer.is_running():
            raise ObserverEndedError(f"{fault.name}: the observer ended with {stage.observer.process.returncode}")
        yield evaluate_episode(episode, stage.monitor.estimates, stage.monitor.diagnoses, rules)


def inject_fault(stage: Stage, fault: Fault, dice: Random) -> FaultEpisode:
    """Inject the fault and return the episode with its times."""
    seconds, seed = dice.uniform(*fault.seconds), dice.randrange(1 << 31)
    episode = FaultEpisode(fault, began_at=time.time_ns())
    if fault.action:
        ACTIONS[fault.action](stage, episode, seconds)
        return episode
    stage.source.send(id=0, spoiler=fault.spoiler, seconds=seconds, seed=seed)
    ended = stage.source.wait_for_event("ended")
    episode.good_at, episode.good_ns = ended["at_ns"], ended["good_ns"]
    episode.first_ns, episode.last_ns = ended["first_ns"], ended["last_ns"]
    return episode


def wait_until_well(stage: Stage) -> bool:
    """Wait until estimates arrive and the diagnostics report no error; return False if that takes too long."""
    now_ns, end = time.time_ns(), time.monotonic() + WELL_WITHIN_S
    while not stage.monitor.is_well(now_ns):
        if time.monotonic() > end or not stage.observer.is_running():
            return False
        time.sleep(0.01)
    return True


def rounds(faults: Iterable[Fault], dice: Random, until: float) -> Iterator[Fault]:
    """Yield all faults in random order, repeatedly until `time.monotonic()` passes `until`.

    The first round begins with the faults that allocate memory once, so that later growth becomes visible.
    """
    chosen = list(faults)
    dice.shuffle(chosen)
    chosen.sort(key=lambda fault: not (fault.action or fault.doubles))
    while True:
        for fault in chosen:
            if time.monotonic() >= until:
                return
            yield fault
        dice.shuffle(chosen)
