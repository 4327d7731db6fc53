"""The observer node: piston position and valve current in, estimated damping force out on `~/estimate`.

It is driven by the position samples; its timer watches for silence, for what is under way beside the samples, and
publishes `/diagnostics`. What it cannot stand for it withholds, saying why, and resumes by itself.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from time import monotonic

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter

from ces_observer.damper_observer import DamperObserver
from ces_observer.health.load_meter import LoadMeter
from ces_observer.nodes import executors
from ces_observer.nodes.damper_topics import DamperTopics
from ces_observer.nodes.diagnostics_output import DiagnosticsOutput, Report, status_with
from ces_observer.nodes.inputs import Inputs
from ces_observer.nodes.model_changes import ModelChanges, ModelUser
from ces_observer.nodes.model_check import PROVE
from ces_observer.nodes.model_reload import Verdict
from ces_observer.nodes.node_clock import NodeClock
from ces_observer.nodes.node_parameters import TableNode
from ces_observer.nodes.observer_parameters import Settings, declare_settings, governing, refusal
from ces_observer.nodes.recording import Recording

WATCH_S = 0.1  # period of the watch, and least time between two diagnostics
DIAGNOSTICS_S = 1.0


class Observer(TableNode):
    """The node `observer` with its dampers; raises what executors.START_ERRORS lists if it cannot be built."""

    def __init__(self) -> None:
        super().__init__("observer")
        settings = declare_settings(self)
        self.executor_choice = settings.values["executor"]
        self._time = NodeClock(self, self._jumped)
        self._inputs = Inputs(self, self._time, self._unexpected)
        self._recording = Recording(self, self._inputs, settings.values)
        self._dampers = [self._damper(one) for one in settings.dampers]
        self._diagnostics = DiagnosticsOutput(self)
        self._load = LoadMeter()
        self._watched = self._rolled = self._told = monotonic()
        self._pending = False
        self._jumps = self._failures = self._failures_told = 0
        self._failure = self._jump = "none"
        self.add_on_set_parameters_callback(self._check)
        self.add_post_set_parameters_callback(self._set)
        self.create_timer(WATCH_S, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def destroy_node(self) -> None:
        """End what is under way besides the samples, then the node."""
        for _, changes in self._dampers:
            changes.close()
        self._recording.close()
        self._time.close()
        super().destroy_node()

    def _damper(self, settings: Settings) -> tuple[DamperTopics, ModelChanges]:
        topics = DamperTopics(self, settings, self._inputs, self._time, self._changed, self._measured)
        user = ModelUser(
            running=lambda: topics.damper.model,
            adopt=partial(_adopt, topics.damper),
            parameter=partial(governing, self, settings, "model"),
            prefix=settings.topics,
            topic=settings.values["model_topic"],
            tasks=() if settings.values["allow_uncertified"] else (PROVE,),
        )
        changes = ModelChanges(self, user, settings.model_path)
        topics.use_model(changes.source)
        return topics, changes

    def _watch(self) -> None:
        try:
            self._look()
        except Exception as error:  # the next look may be better; the samples need the node
            self._unexpected(error)

    def _look(self) -> None:
        now = monotonic()
        elapsed, self._watched = now - self._watched, now
        self._time.watch()
        for topics, changes in self._dampers:
            topics.watch(elapsed)
            if changes.poll():
                topics.use_model(changes.source)
        self._recording.work(self._time.now())
        if now - self._rolled >= DIAGNOSTICS_S:
            self._roll(now - self._rolled)
            self._rolled = now
            self._tell()
            executors.collect()
        elif self._pending:
            self._tell()

    def _roll(self, elapsed_s: float) -> None:
        load, now_ns = self._load.look(), self._time.now()
        for topics, _ in self._dampers:
            topics.health.roll(elapsed_s, now_ns, load)

    def _changed(self) -> None:
        """Tell of a new reason at once, unless the last telling was just now: then the watch does."""
        self._pending = True
        if monotonic() - self._told >= WATCH_S:
            self._tell()

    def _tell(self) -> None:
        self._told, self._pending = monotonic(), False
        self._diagnostics.publish([self._report(topics, changes) for topics, changes in self._dampers])
        self._failures_told = self._failures

    def _report(self, topics: DamperTopics, changes: ModelChanges) -> Report:
        status = topics.health.status(topics.detail())
        if self._failures > self._failures_told:
            status = status_with(status, f"{self._failures} unexpected errors, the last: {self._failure}")
        others = (
            *changes.values(),
            ("jumps of time", f"{self._jumps}, the last: {self._jump}"),
            ("unexpected errors", f"{self._failures}, the last: {self._failure}"),
        )
        values = (*status.values, *others)
        damper = topics.settings.key or topics.settings.name
        return Report(damper, topics.settings.name, topics.damper.reason, replace(status, values=values))

    def _measured(self, topics: DamperTopics) -> None:
        """Compare with the measured force, and record for the case that the comparison fails, once there is one."""
        topics.compare()
        self._recording.begin([each for each, _ in self._dampers])
        topics.health.box = self._recording.box

    def _jumped(self, what: str) -> None:
        """Begin anew after a jump of time."""
        try:
            self._jumps, self._jump = self._jumps + 1, what
            self.get_logger().warning(f"{what}: the estimates begin anew")
            for topics, _ in self._dampers:
                topics.reset()
        except Exception as error:  # rcl calls this in the middle of setting its clock
            self._unexpected(error)

    def _unexpected(self, error: Exception) -> None:
        """Count what should not happen, for the next telling; no message may end the node."""
        self._failures += 1
        self._failure = f"{type(error).__name__}: {error}"

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        reason = refusal(self, parameters)
        return SetParametersResult(successful=not reason, reason=reason)

    def _set(self, parameters: Sequence[Parameter]) -> None:
        changed = {parameter.name.rpartition(".")[2] for parameter in parameters}
        try:
            for topics, changes in self._dampers:
                topics.set_live_values()
                if "model" in changed:
                    changes.parameter_set()
        except Exception as error:  # the parameter is set; the samples need the node
            self._unexpected(error)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; returns 0 when stopped by a signal, 2 if a parameter or the model cannot be used."""
    return executors.run("observer", Observer, argv)


def _adopt(damper: DamperObserver, verdict: Verdict) -> str:
    damper.load(verdict.model)
    return f"when warmed up, after {verdict.model.sampling.warm_up_s:g} s of samples"


if __name__ == "__main__":
    sys.exit(main())
