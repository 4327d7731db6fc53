"""The observer node: piston position and valve current in, estimated damping force out on `~/estimate`.

The position samples drive it. A timer checks for silence, continues model changes and recordings, and publishes
`/diagnostics`, which name the reason for each withheld force. The node resumes by itself.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from time import monotonic
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter

from ces_observer.damper_observer import DamperObserver
from ces_observer.health.load_meter import LoadMeter
from ces_observer.health.process_watch import ProcessWatch
from ces_observer.nodes import executors
from ces_observer.nodes.black_box_recording import BlackBoxRecording
from ces_observer.nodes.damper_topics import DamperTopics
from ces_observer.nodes.diagnostics_output import DamperReport, DiagnosticsOutput, add_remark
from ces_observer.nodes.input_subscriptions import InputSubscriptions
from ces_observer.nodes.model_changes import ModelChanges, ModelUser
from ces_observer.nodes.model_check import PROVE, describe_model
from ces_observer.nodes.model_reload import Verdict
from ces_observer.nodes.node_clock import NodeClock
from ces_observer.nodes.node_parameters import TableNode
from ces_observer.nodes.observer_parameters import DamperSettings, declare_settings, find_refusal, governing_parameter
from ces_observer.real_time import check_processors

WATCH_S = 0.1  # period of the watch timer, and minimum time between two diagnostics
DIAGNOSTICS_S = 1.0


class Observer(TableNode):
    """The node `observer` with its dampers; raises what executors.START_ERRORS lists if it cannot be built."""

    def __init__(self) -> None:
        super().__init__("observer")
        settings = declare_settings(self)
        self.executor_choice = settings.values["executor"]
        self._time = NodeClock(self, self._on_time_jump)
        self._inputs = InputSubscriptions(
            self, self._time, depth=settings.values["input_depth"], drain=executors.is_single(self.executor_choice)
        )
        self._recording = BlackBoxRecording(self, self._inputs, settings.values)
        self._dampers = [self._make_damper(one) for one in settings.dampers]
        self._diagnostics = DiagnosticsOutput(self)
        self._load = LoadMeter()
        self._process = self._make_process_watch(settings.values)
        self._watched = self._rolled = self._reported_s = monotonic()
        self._pending = False
        self._jumps, self._jump = 0, "none"
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)
        self.create_timer(WATCH_S, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def destroy_node(self) -> None:
        """End model changes, recording and clock callbacks, then the node."""
        for close in (*(changes.close for _, changes in self._dampers), self._recording.close, self._time.close):
            self.guard.call(close)
        super().destroy_node()

    def _make_damper(self, settings: DamperSettings) -> tuple[DamperTopics, ModelChanges]:
        topics = DamperTopics(self, settings, self._inputs, self._time, self._on_change, self._on_first_force)
        user = ModelUser(
            running=lambda: topics.damper.model,
            adopt=partial(_adopt, topics.damper),
            parameter=partial(governing_parameter, self, settings, "model"),
            prefix=settings.topics,
            topic=settings.values["model_topic"],
            tasks=() if settings.values["allow_uncertified"] else (PROVE,),
            require=topics.damper.require_signals,
        )
        changes = ModelChanges(self, user, settings.model_path)
        topics.use_model(changes.source)
        self.get_logger().info(f"{settings.name}: {describe_model(settings.model)}")
        return topics, changes

    def _make_process_watch(self, values: dict[str, Any]) -> ProcessWatch:
        processors = check_processors(values["cpu_affinity"])
        warn = self.get_logger().warning
        return ProcessWatch(values["realtime_priority"], processors, values["lock_memory"], warn)

    def _watch(self) -> None:
        """Do what is due; a step that fails does not keep the others from being done."""
        now = monotonic()
        elapsed, self._watched = now - self._watched, now
        self.guard.call(self._time.watch)
        for topics, changes in self._dampers:
            self.guard.wrap(topics.watch, topics.restart)(elapsed)
            self.guard.call(partial(_poll_model, topics, changes))
        self.guard.call(lambda: self._recording.work(self._time.now()))
        if now - self._rolled >= DIAGNOSTICS_S:
            elapsed, self._rolled = now - self._rolled, now
            self.guard.call(partial(self._roll, elapsed))
            self._publish_status()
            executors.collect_garbage()
        elif self._pending:
            self._publish_status()

    def _roll(self, elapsed_s: float) -> None:
        self._process.update()
        load, now_ns = self._load.measure(), self._time.now()
        for topics, _ in self._dampers:
            topics.health.roll(elapsed_s, now_ns, load)

    def _on_change(self) -> None:
        """Report a new reason at once, or by the watch timer if the last report was just now."""
        self._pending = True
        if monotonic() - self._reported_s >= WATCH_S:
            self._publish_status()

    def _publish_status(self) -> None:
        self._reported_s, self._pending = monotonic(), False
        remark = self.guard.take_remark()
        self._diagnostics.publish([self._make_report(topics, changes, remark) for topics, changes in self._dampers])

    def _make_report(self, topics: DamperTopics, changes: ModelChanges, remark: str) -> DamperReport:
        status = add_remark(topics.health.status(topics.detail()), self._process.remark())
        status = add_remark(status, remark)
        others = (
            *changes.values(),
            *self._process.values(),
            ("jumps of time", f"{self._jumps}, the last: {self._jump}"),
            *self.guard.values(),
        )
        values = (*status.values, *others)
        damper = topics.settings.key or topics.settings.name
        return DamperReport(damper, topics.settings.name, topics.damper.reason, replace(status, values=values))

    def _on_first_force(self, topics: DamperTopics) -> None:
        """Start the comparison with the measured force, and the black box for a drift."""
        topics.compare()
        self._recording.begin([damper for damper, _ in self._dampers])
        topics.health.box = self._recording.box

    def _on_time_jump(self, what: str) -> None:
        """Restart after a time jump."""
        self._jumps, self._jump = self._jumps + 1, what
        self.get_logger().warning(f"{what}: the estimates restart")
        self._inputs.reset()
        for topics, _ in self._dampers:
            self.guard.wrap(topics.reset, topics.restart)()

    def _check_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        reason = find_refusal(self, parameters)
        return SetParametersResult(successful=not reason, reason=reason)

    def _apply_parameters(self, parameters: Sequence[Parameter]) -> None:
        changed = {parameter.name.rpartition(".")[2] for parameter in parameters}
        for topics, changes in self._dampers:
            self.guard.call(topics.set_live_values)
            if "model" in changed:
                self.guard.call(changes.begin_from_parameter)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; returns 0 when stopped by a signal, 2 if a parameter or the model cannot be used."""
    return executors.run("observer", Observer, argv)


def _poll_model(topics: DamperTopics, changes: ModelChanges) -> None:
    if changes.poll():
        topics.use_model(changes.source)


def _adopt(damper: DamperObserver, verdict: Verdict) -> str:
    damper.load(verdict.model)
    return f"when warmed up, after {verdict.model.sampling.warm_up_s:g} s of samples"


if __name__ == "__main__":
    sys.exit(main())
