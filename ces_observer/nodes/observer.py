"""The observer node: piston position and valve current in, estimated damping force out on `~/estimate`.

The position samples drive it. A timer checks for silence, continues model changes and snapshots, and publishes
`/diagnostics`, which name the reason for each withheld force. The node resumes by itself.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from time import monotonic

from rclpy.parameter import Parameter

from ces_observer.estimator import Estimator
from ces_observer.health.diagnostics import NodeFacts, unconfigured_report
from ces_observer.health.process import ProcessWatch
from ces_observer.limits import NodeLimits
from ces_observer.nodes import executors
from ces_observer.nodes.damper_topics import DamperTopics
from ces_observer.nodes.executors import RARELY, NodeClock
from ces_observer.nodes.inputs import InputSubscriptions
from ces_observer.nodes.managed_node import ManagedNode
from ces_observer.nodes.model_changes import ModelChanges, ModelUser
from ces_observer.nodes.model_check import PROVE, describe_model
from ces_observer.nodes.outputs import DamperReport, DiagnosticsOutput
from ces_observer.nodes.parameters import (
    DamperSettings,
    check_live_values,
    declare_observer,
    governing_parameter,
    read_dampers,
    value_of,
)
from ces_observer.nodes.snapshot import Snapshots

WATCH_S = 0.1  # period of the watch timer, and minimum time between two diagnostics
DIAGNOSTICS_S = 1.0


class Observer(ManagedNode):
    """The node `observer` with its dampers; raises what executors.START_ERRORS lists if it cannot be built."""

    def __init__(self) -> None:
        super().__init__("observer")
        self._values, self._keys = values, _ = declare_observer(self)
        self.executor_choice = values["executor"]
        self._time = NodeClock(self, self._on_time_jump)
        self._dampers: list[tuple[DamperTopics, ModelChanges]] = []
        self._diagnostics = DiagnosticsOutput(self)
        self._process = ProcessWatch()
        self._watched = self._rolled = self._reported_s = monotonic()
        self._pending = False
        self.refuse_parameters(check_live_values)
        self.add_post_set_parameters_callback(self._apply_parameters)
        self.create_steady_timer(WATCH_S, self._watch)

    def configure(self) -> None:
        """Load and prove the models, and make the topics of each damper."""
        settings, values = read_dampers(self, self._keys), {name: value_of(self, name) for name in self._values}
        self.made.callback(self._dampers.clear)
        drain = executors.is_single(self.executor_choice)
        self._inputs = InputSubscriptions(
            self, self._time, depth=values["input_depth"], drain=drain, on_silence=self._on_silence
        )
        self.made.callback(self._inputs.close)
        self._snapshots = Snapshots(self, values["snapshot_service"], values["snapshot_after_s"])
        self.made.callback(self._snapshots.close)
        for one in settings:
            self._dampers.append(self._make_damper(one))

    def destroy_node(self) -> None:
        """End the clock's callbacks, and the node."""
        self.guard.call(self._time.close)
        super().destroy_node()

    def _make_damper(self, settings: DamperSettings) -> tuple[DamperTopics, ModelChanges]:
        topics = DamperTopics(self, settings, self._inputs, self._time, self._on_change, self._on_first_force)
        user = ModelUser(
            running=lambda: topics.damper.model,
            adopt=topics.adopt,
            parameter=partial(governing_parameter, self, settings.prefix, "model"),
            prefix=settings.topics,
            tasks=() if settings.values["allow_uncertified"] else (PROVE,),
            require=topics.damper.motion_for,
            prepare=Estimator,  # its numbers are kept for the model that will run
        )
        changes = ModelChanges(self, user, settings.model_path)
        self.made.callback(changes.close)
        topics.use_model(changes.source)
        self.get_logger().info(f"{settings.label}: {describe_model(settings.model)}")
        return topics, changes

    def _watch(self) -> None:
        """Do what is due; a step that fails does not keep the others from being done."""
        now = monotonic()
        elapsed, self._watched = now - self._watched, now
        self.guard.call(self._time.watch)
        for topics, changes in self._dampers:
            self.guard.wrap(topics.watch, topics.restart)(elapsed)
            self.guard.call(partial(self._poll_model, topics, changes))
        if self._dampers:
            self.guard.call(self._snapshots.work)
        self.guard.call(self.bond.watch)
        self._watch_failures()
        if now - self._rolled >= DIAGNOSTICS_S:
            elapsed, self._rolled = now - self._rolled, now
            self.guard.call(partial(self._roll, elapsed))
            self._publish_status(details=True)
        elif self._pending:
            self._publish_status()

    def _watch_failures(self) -> None:
        """Leave the active state if a damper does nothing but fail, and come back later."""
        failing = [topics.settings.label for topics, _ in self._dampers if topics.failing_s >= NodeLimits.FALL_S]
        if failing:
            self.guard.call(
                partial(self.fall, f"{', '.join(failing)}: each sample has failed for {NodeLimits.FALL_S:g} s")
            )
            self._publish_status()
        self.guard.call(self.start_again)

    def _poll_model(self, topics: DamperTopics, changes: ModelChanges) -> None:
        if changes.poll():
            topics.use_model(changes.source)

    def _roll(self, elapsed_s: float) -> None:
        load, now_ns = self._process.update(), self._time.now()
        for topics, _ in self._dampers:
            topics.health.roll(elapsed_s, now_ns, load)
            self.guard.call(topics.note_mismatches)

    def _on_change(self) -> None:
        """Report a new reason at once, or by the watch timer if the last report was just now."""
        self._pending = True
        if monotonic() - self._reported_s >= WATCH_S:
            self._publish_status()

    def _publish_status(self, details: bool = False) -> None:
        self._reported_s, self._pending = monotonic(), False
        remark = self.guard.take_remark()
        reports = [self._make_report(topics, changes, remark) for topics, changes in self._dampers]
        if not reports:
            reports = [DamperReport(key, "", unconfigured_report("estimate")) for key in self._keys or ("damper",)]
        self._diagnostics.publish(reports, details)

    def _make_report(self, topics: DamperTopics, changes: ModelChanges, remark: str) -> DamperReport:
        values = (*changes.values(), *self._process.values(), *self.guard.values())
        facts = NodeFacts(self.state, (self._process.remark(), remark), values)
        return DamperReport(topics.settings.label, topics.settings.name, topics.health.report(topics.detail(), facts))

    def _on_silence(self, topic: str) -> None:
        for topics, _ in self._dampers:
            topics.note_silence(topic)

    def _on_first_force(self, topics: DamperTopics) -> None:
        """Start the comparison with the measured force; a drift asks for a snapshot."""
        topics.compare()
        topics.health.snapshots = self._snapshots

    def _on_time_jump(self, what: str) -> None:
        self.get_logger().warning(f"{what}: the estimates restart", **RARELY)
        if self._dampers:
            self._inputs.reset()
        for topics, _ in self._dampers:
            topics.health.note_jump(what)
            self.guard.wrap(topics.reset, topics.restart)()

    def _apply_parameters(self, parameters: Sequence[Parameter]) -> None:
        changed = {parameter.name.rpartition(".")[2] for parameter in parameters}
        for topics, changes in self._dampers:
            self.guard.call(topics.set_live_values)
            if "model" in changed:
                self.guard.call(changes.begin_from_parameter)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; returns 0 when stopped by a signal, 2 if a parameter or the model cannot be used."""
    return executors.run("observer", Observer, argv)


if __name__ == "__main__":
    sys.exit(main())
