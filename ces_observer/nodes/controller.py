"""The controller node: estimates of speed and force in, valve current on `valve_command` out.

The estimates drive it, so that the damper's force follows a desired speed-force curve. A timer commands the safe
current when they stop, and publishes `/diagnostics`, which name the reason. The node resumes by itself.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from math import nan
from time import monotonic

from rclpy.parameter import Parameter

from ces_observer.control.control_loop import ControllerHealth, ControlLoop
from ces_observer.control.force_controller import NO_ESTIMATE, OK, ForceController
from ces_observer.control.inverse_map import ModelInverse
from ces_observer.health.diagnostics import NodeFacts, unconfigured_report
from ces_observer.nodes import executors
from ces_observer.nodes.executors import RARELY, NodeClock
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.inputs import InputSubscriptions
from ces_observer.nodes.managed_node import ManagedNode
from ces_observer.nodes.model_changes import ModelChanges, ModelUser
from ces_observer.nodes.model_check import INVERT, PROVE, Verdict, model_facts
from ces_observer.nodes.outputs import CommandOutput, DamperReport, DiagnosticsOutput
from ces_observer.nodes.parameters import (
    ControllerSettings,
    LiveSettings,
    declare_controller,
    read_controller,
    read_live_settings,
)
from ces_observer.signals import FieldPath, Signal

WATCH_S = 0.01  # period of the watch for silence
REPORT_S = 0.1  # minimum time between two diagnostics
DIAGNOSTICS_S = 1.0


class ControllerModel:
    """The model of a running controller with its `changes`; `lag_s` [s] is its force's lag behind the current."""

    def __init__(self, node: GuardedNode, settings: ControllerSettings, controller: ForceController) -> None:
        self.lag_s = settings.inverse.lag_s
        self._node, self._controller, self._model = node, controller, settings.model
        user = ModelUser(
            running=lambda: self._model,
            adopt=self._adopt,
            parameter=lambda: "model",
            prefix="~/",
            tasks=(INVERT,) if settings.values["allow_uncertified"] else (PROVE, INVERT),
        )
        self.changes = ModelChanges(node, user, settings.model_path)

    def facts(self) -> dict[str, str]:
        """Return the model's key-value pairs for diagnostics."""
        return {
            "model": self.changes.source,
            **model_facts(self._model),
            "lag of the model's force behind the current [ms]": f"{self.lag_s * 1e3:.1f}",
        }

    def _adopt(self, verdict: Verdict) -> str:
        inverse = ModelInverse.from_json(verdict.inverse)
        tuning = read_live_settings(self._node, (), inverse.lag_s).tuning
        self._model, self.lag_s = verdict.model, inverse.lag_s
        self._controller.tuning = tuning
        self._controller.adopt(inverse.map)
        return f"within {tuning.recovery_s:g} s"


class Controller(ManagedNode):
    """The node `controller`; raises what executors.START_ERRORS lists if it cannot be built."""

    def __init__(self) -> None:
        super().__init__("controller")
        self._values = declare_controller(self)
        self.executor_choice = self._values["executor"]
        self._time = NodeClock(self, self._on_time_jump)
        self._diagnostics = DiagnosticsOutput(self)
        self._rolled = self._reported_s = monotonic()
        self._reported_reason = ""
        self._speed, self._unreadable = nan, ""
        self._is_configured = False
        self.refuse_parameters(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)
        self.create_steady_timer(WATCH_S, self._watch)

    def configure(self) -> None:
        """Load, prove and invert the model, and make the topics."""
        self._settings = settings = read_controller(self, self._values)
        live = settings.live
        controller = ForceController(live.curve, settings.inverse.map, live.tuning)
        self._loop = ControlLoop(controller, live.feedback, live.max_age_s)
        self._model = ControllerModel(self, settings, controller)
        self.made.callback(self._model.changes.close)
        self._health = ControllerHealth(self._loop, self._model.facts())
        self._output = CommandOutput(self)
        self.made.callback(self._output.close)
        self._subscribe(settings)
        self._is_configured = True
        self.made.callback(setattr, self, "_is_configured", False)

    def deactivate(self) -> None:
        """Send the safe current, which the valve then keeps."""
        self._output.publish(self._loop.controller.tuning.safe_A)
        self._loop.restart()

    def destroy_node(self) -> None:
        """End the clock's callbacks, and the node."""
        self.guard.call(self._time.close)
        super().destroy_node()

    def _subscribe(self, settings: ControllerSettings) -> None:
        """Subscribe to the speed before the force: of the two numbers in an estimate it is delivered first."""
        inputs, values, reset = InputSubscriptions(self, self._time), settings.values, self._loop.restart
        self.made.callback(inputs.close)
        place = values["joint"] or "0"  # without a joint's name: the first in the message

        def signal(name: str, kind: str, field: str) -> Signal:
            return Signal(name, values[name], kind, FieldPath.parse(field))

        speed, force = (
            signal("estimate_topic", "sensor_msgs/msg/JointState", f"{field}[{place}]")
            for field in ("velocity", "effort")
        )
        measured = signal("force_topic", "geometry_msgs/msg/WrenchStamped", "wrench.force.z")
        inputs.subscribe(speed, self._on_speed, self._on_unreadable_speed, reset)
        inputs.subscribe(force, self._on_force, self._on_unreadable_force, reset)
        inputs.subscribe(measured, self._on_measured, self._on_unreadable_force, reset)

    def _on_speed(self, stamp_ns: int, speed_m_s: float, frame: bytes, now_ns: int) -> None:
        del stamp_ns, frame, now_ns
        self._speed = speed_m_s

    def _on_force(self, stamp_ns: int, force_N: float, frame: bytes, now_ns: int) -> None:
        self._unreadable = ""
        loop = self._loop
        if not self.is_active:
            return
        self._output.publish(loop.take_estimate(stamp_ns, self._speed, force_N, now_ns, monotonic()))
        self._health.latency.take(self._time.now() - stamp_ns)
        if loop.controller.reason == OK:
            self._output.publish_desired(stamp_ns, frame, loop.controller.reachable_N)
        self.guard.call(self._publish_change)

    def _on_measured(self, stamp_ns: int, force_N: float, frame: bytes, now_ns: int) -> None:
        del stamp_ns, frame, now_ns
        self._loop.take_measured_force(force_N, monotonic())

    def _on_unreadable_speed(self, error: str) -> None:
        self._speed = nan
        self._unreadable = error

    def _on_unreadable_force(self, error: str) -> None:
        self._unreadable = error

    def _on_time_jump(self, what: str) -> None:
        self.get_logger().warning(f"{what}: the controller restarts", **RARELY)
        if self._is_configured:
            self._loop.controller.reset()

    def _watch(self) -> None:
        """Do what is due; the command first, whatever fails then."""
        now = monotonic()
        if self.is_active:
            self.guard.wrap(self._watch_estimates, self._loop.restart)(now)
            self.guard.call(self.bond.watch)
        if self._is_configured:
            self.guard.call(self._poll_model)
            self._publish_change()
        if now - self._rolled >= DIAGNOSTICS_S:
            elapsed, self._rolled = now - self._rolled, now
            self._roll(elapsed)

    def _roll(self, elapsed_s: float) -> None:
        self.guard.call(self._time.watch)
        if not self._is_configured:
            self._diagnostics.publish([DamperReport("controller", "", unconfigured_report("control"))])
            return
        self.guard.call(partial(self._health.roll, elapsed_s))
        self._publish_status(details=True)

    def _watch_estimates(self, now: float) -> None:
        current_A = self._loop.watch(now, WATCH_S)
        if current_A is not None:
            self._output.publish(current_A)

    def _poll_model(self) -> None:
        if self._model.changes.poll():
            self._health.set_facts(self._model.facts())

    def _publish_change(self) -> None:
        """Report a new reason at once, or by the watch timer if the last report was just now."""
        if self._loop.controller.reason != self._reported_reason and monotonic() - self._reported_s >= REPORT_S:
            self._publish_status()

    def _publish_status(self, details: bool = False) -> None:
        self._reported_s, self._reported_reason = monotonic(), self._loop.controller.reason
        values = (*self._model.changes.values(), *self.guard.values())
        facts = NodeFacts(self.state, (self.guard.take_remark(),), values)
        joint = self._settings.values["joint"] or "damper"
        report = self._health.report(self._detail(), facts)
        self._diagnostics.publish([DamperReport("controller", joint, report)], details)

    def _detail(self) -> str:
        if self._loop.controller.reason != NO_ESTIMATE:
            return ""
        topic = self.resolve_topic_name(self._settings.values["estimate_topic"])
        silent = "has a publisher that is silent" if self.count_publishers(topic) else "is published by nobody"
        return self._unreadable or f"{topic} {silent}"

    def _apply_parameters(self, parameters: Sequence[Parameter]) -> None:
        if not self._is_configured:
            return
        live, loop = self._check_parameters(parameters), self._loop
        loop.controller.curve, loop.controller.tuning = live.curve, live.tuning
        loop.feedback, loop.max_age_s = live.feedback, live.max_age_s
        if any(parameter.name == "model" for parameter in parameters):
            self._model.changes.begin_from_parameter()

    def _check_parameters(self, parameters: Sequence[Parameter]) -> LiveSettings:
        """Return the live settings with `parameters` changed; raises CesError."""
        return read_live_settings(self, parameters, self._model.lag_s if self._is_configured else 0.0)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; returns 0 when stopped by a signal, 2 if a parameter or the model cannot be used."""
    return executors.run("controller", Controller, argv)


if __name__ == "__main__":
    sys.exit(main())
