"""A campaign: observer, source and monitor run side by side; faults are injected at random times and evaluated."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random

from bench.reliability.judge import (
    REPORT_WITHIN_NS,
    EpisodeLimits,
    Fault,
    FaultEpisode,
    FaultOutcome,
    evaluate_episode,
)
from bench.reliability.processes import ObserverMonitor, ObserverProcess, SourceProcess
from bench.reliability.ride import TrueForce
from ces_observer.model import Model
from ces_observer.structures.polynomial import Polynomial

MAX_AGE_S = 0.5
ADOPTED_WITHIN_S = 20.0  # a new process must start and verify the model


@dataclass
class Stage:
    """All participants, the model, and the file in the observer's parameter `model`."""

    observer: ObserverProcess
    source: SourceProcess
    monitor: ObserverMonitor
    model: Model
    model_path: Path
    version: int = 0

    def new_model(self) -> tuple[str, str]:
        """Return text and digest of the same model with another provenance, to identify the running one."""
        self.version += 1
        model = replace(self.model, provenance={**self.model.provenance, "version": str(self.version)})
        return model.to_json(), model.digest()

    def file(self, name: str, text: str) -> str:
        """Write a model file beside the first one, and return its path."""
        path = self.model_path.with_name(name)
        path.write_text(text, encoding="utf-8")
        return str(path)


Action = Callable[[Stage, FaultEpisode, float], None]


def stop_source(stage: Stage, episode: FaultEpisode, seconds: float) -> None:
    stage.source.process.send_signal(signal.SIGSTOP)
    time.sleep(seconds)
    stage.source.process.send_signal(signal.SIGCONT)
    caught_up = stage.source.wait_for_event("caught up")
    episode.good_at, episode.good_ns = caught_up["at_ns"], caught_up["good_ns"]


def stop_observer(stage: Stage, episode: FaultEpisode, seconds: float) -> None:
    stage.observer.process.send_signal(signal.SIGSTOP)
    time.sleep(seconds)
    mark_good(stage, episode)
    stage.observer.process.send_signal(signal.SIGCONT)


def kill_source(stage: Stage, episode: FaultEpisode, seconds: float) -> None:
    stage.source.kill()
    time.sleep(seconds)
    running = stage.source.restart()
    episode.good_at, episode.good_ns = running["at_ns"], running["good_ns"]


def change_model(stage: Stage, episode: FaultEpisode, seconds: float) -> None:
    text, digest = stage.new_model()
    path = stage.file(f"model{stage.version}.json", text)
    expect(episode, stage.monitor.set_parameter("model", path), True)
    stage.model_path = Path(path)
    wait_until_adopted(stage, episode, digest)


def change_to_bad_model(stage: Stage, episode: FaultEpisode, seconds: float) -> None:
    text = stage.model.to_json().replace('"schema"', '"shema"')
    expect(episode, stage.monitor.set_parameter("model", stage.file("bad.json", text)), False)
    mark_good(stage, episode)


def reload_model(stage: Stage, episode: FaultEpisode, seconds: float) -> None:
    text, digest = stage.new_model()
    stage.file(stage.model_path.name, text)
    expect(episode, stage.monitor.reload_model(), True)
    wait_until_adopted(stage, episode, digest)


def reload_bad_model(stage: Stage, episode: FaultEpisode, seconds: float) -> None:
    good = stage.model_path.read_text(encoding="utf-8")
    stage.file(stage.model_path.name, make_unstable(stage.model).to_json())
    expect(episode, stage.monitor.reload_model(), False)
    stage.file(stage.model_path.name, good)
    mark_good(stage, episode)


def change_max_age(stage: Stage, episode: FaultEpisode, seconds: float) -> None:
    for value in (Random(episode.began_at).uniform(0.3, 3600.0), 0.0, MAX_AGE_S):
        expect(episode, stage.monitor.set_parameter("max_age_s", value), True)
    mark_good(stage, episode)


def change_to_bad_age(stage: Stage, episode: FaultEpisode, seconds: float) -> None:
    for value in (-1.0, float("inf"), float("nan"), "often"):
        expect(episode, stage.monitor.set_parameter("max_age_s", value), False)
    mark_good(stage, episode)


def make_unstable(model: Model) -> Model:
    """Return the model with all coefficients multiplied by 100: well formed, but impossible to certify."""
    terms = tuple(replace(term, coefficient=100.0 * term.coefficient) for term in model.body.terms)
    return replace(model, body=Polynomial(terms))


def expect(episode: FaultEpisode, answer: tuple[bool, str], accepted: bool) -> None:
    """Record the node's answer if it is wrong; it must accept, or refuse with a reason."""
    if answer[0] != accepted or not (accepted or answer[1]):
        episode.wrong.append(f"the node answered {'yes' if answer[0] else 'no'} ({answer[1] or 'no reason'})")


def wait_until_adopted(stage: Stage, episode: FaultEpisode, digest: str) -> None:
    """Wait until the diagnostics name the model by its digest."""
    end = time.monotonic() + ADOPTED_WITHIN_S
    while not any(digest in value for value in stage.monitor.diagnoses[-1].values.values()):
        if time.monotonic() > end:
            episode.wrong.append(f"the new model is not in the diagnostics after {ADOPTED_WITHIN_S:g} s")
            break
        time.sleep(0.01)
    mark_good(stage, episode)


def mark_good(stage: Stage, episode: FaultEpisode) -> None:
    episode.good_at, episode.good_ns = time.time_ns(), stage.source.stamp_now()


ACTIONS: dict[str, Action] = {
    "stop source": stop_source,
    "stop observer": stop_observer,
    "kill source": kill_source,
    "other model": change_model,
    "bad model": change_to_bad_model,
    "reload": reload_model,
    "bad reload": reload_bad_model,
    "age": change_max_age,
    "bad age": change_to_bad_age,
}


WELL_WITHIN_S = 10.0


class ObserverEndedError(Exception):
    """The observer ended during a campaign."""


@contextmanager
def start_stage(model: Model, folder: Path, namespace: str = "/faults") -> Iterator[Stage]:
    """Start all processes; `folder` receives model files and log. `ObserverProcess.end` must end the observer."""
    path = folder / "model.json"
    model.save(path)
    parameters = {"model": path, "max_age_s": MAX_AGE_S}
    with ObserverMonitor(namespace) as monitor:
        observer = ObserverProcess(namespace, parameters, folder / "observer.log")
        try:
            source = SourceProcess(namespace)
            try:
                yield Stage(observer, source, monitor, model, path)
            finally:
                source.kill()
        finally:
            if observer.is_running():
                observer.process.kill()
                observer.process.wait()


def make_limits(model: Model) -> EpisodeLimits:
    truth = TrueForce(model)
    return EpisodeLimits(
        model.force_envelope_N,
        truth.force,
        truth.max_force_N,
        model.sampling.warm_up_s,
        MAX_AGE_S,
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
