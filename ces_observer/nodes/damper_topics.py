"""The topics of one damper: position, current and measured force in, estimates and their bands out."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import monotonic

from ces_observer.current_hold import ConstantCurrent, CurrentHold
from ces_observer.damper_observer import NO_CURRENT, NO_MOTION, SILENT, DamperObserver
from ces_observer.health.health import Health
from ces_observer.health.running_cost import RunningCost, default_warn_J
from ces_observer.health.streams import Arrivals
from ces_observer.intake import Intake
from ces_observer.limits import HealthLimits
from ces_observer.nodes.executors import NodeClock
from ces_observer.nodes.inputs import Deliver, InputSubscriptions
from ces_observer.nodes.managed_node import ManagedNode
from ces_observer.nodes.model_check import Verdict, model_facts
from ces_observer.nodes.outputs import EstimateOutput
from ces_observer.nodes.parameters import DamperSettings, live_value
from ces_observer.signals import MOTIONS, Constant, Signal


class DamperTopics:
    """Inputs, output, estimator and health of one damper.

    `on_change` is called when the damper's reason changes, `on_first_force` when a measured force arrives and there is
    no running cost yet.
    """

    def __init__(
        self, node: ManagedNode, settings: DamperSettings, inputs: InputSubscriptions, clock: NodeClock,
        on_change: Callable[[], None], on_first_force: Callable[[DamperTopics], None],
    ) -> None:  # fmt: skip
        self.settings = settings
        sampling, signals = settings.model.sampling, settings.signals
        current: CurrentHold = CurrentHold(sampling.max_current_age_s)
        if isinstance(signals["current"], Constant):
            current = ConstantCurrent(signals["current"].value)
        measured = [name for name in MOTIONS if isinstance(signals.by_name.get(name), Signal)]
        motions = {name: CurrentHold(sampling.max_gap_s) for name in measured}
        self.damper = DamperObserver(settings.model, current, settings.values["max_age_s"], motions)
        self.health = Health(self.damper, {}, name=settings.label)
        self._node, self._clock, self._inputs = node, clock, inputs
        self._subscribed: list[Signal] = []
        self._on_change, self._on_first_force = node.guard.wrap(on_change), on_first_force
        # What only describes the estimates is guarded apart: an error in it must not withhold them.
        guarded = node.guard.wrap
        self._note_position, self._note_current = guarded(self._count_position), guarded(self._count_current)
        self._note_force = guarded(self._count_force)
        self.health.stillness.warn_s = settings.values["still_warn_s"]
        self._intake = Intake(self.damper, self._publish)
        self._intake.set_wait(settings.values["wait_for_current_s"])
        self._reported_reason = self.damper.reason
        self._last_samples, self._quiet_s = 0, 0.0
        self._failures = self._failures_before = 0
        self._failing_since: float | None = None  # by the steady clock; None: the last sample has not failed
        name, topics = settings.name, settings.topics
        self._now = EstimateOutput(node, name, f"{topics}estimate")
        self._late: EstimateOutput | None = None
        node.made.callback(self._close)
        self._subscribe()

    @property
    def failing_s(self) -> float:
        """For how long each sample has failed [s]."""
        return 0.0 if self._failing_since is None else monotonic() - self._failing_since

    def use_model(self, source: str) -> None:
        """Let health report the damper's model, which comes from `source`."""
        facts = {"model": source, **model_facts(self.damper.model)}
        self._offer_late()
        self.health.set_damper(self.damper, facts, None if self.health.cost is None else self._make_cost())

    def adopt(self, verdict: Verdict) -> str:
        """Let a checked model take over, and return when."""
        self.damper.load(verdict.model)
        self._offer_late()
        return f"when warmed up, after {verdict.model.warm_up_s:.2g} s of samples"

    def compare(self) -> None:
        """Start comparing the estimates with the measured force."""
        self.health.cost = self._make_cost()

    def set_live_values(self) -> None:
        """Apply the parameters that can change while the node runs, except the model."""
        value = partial(live_value, self._node, self.settings.prefix)
        self.damper.set_max_age(value("max_age_s"))
        self._intake.set_wait(value("wait_for_current_s"))
        self.health.stillness.warn_s = value("still_warn_s")
        if self.health.cost is not None:
            self.health.cost.warn_J = value("cost_warn_J") or default_warn_J(self.damper.model)

    def watch(self, elapsed_s: float) -> None:
        """Release positions that have waited, and check for silence, `elapsed_s` after the last call."""
        self._intake.release(self._clock.now())
        if self._failures == self._failures_before:
            self._failing_since = None
        self._failures_before = self._failures
        samples = self.damper.tally.samples
        self._quiet_s = 0.0 if samples != self._last_samples else self._quiet_s + elapsed_s
        self._last_samples = samples
        if self._quiet_s >= max(HealthLimits.MIN_SILENCE_S, self.damper.model.sampling.max_gap_s):
            self.damper.report_silence()
            self._report_change()

    def note_silence(self, topic: str) -> None:
        """Withhold at once, where the middleware says that no position comes: `watch` notices it later."""
        position = self.settings.signals["position"]
        if isinstance(position, Signal) and topic == self._node.resolve_topic_name(position.topic):
            self.damper.report_silence()
            self._report_change()

    def note_mismatches(self) -> None:
        """Look for publishers that cannot be heard, and say so once."""
        found = "; ".join(filter(None, map(self._inputs.find_mismatch, self._subscribed)))
        if found and found != self.health.mismatch:
            self._node.get_logger().warning(f"{self.settings.label}: {found}")
        self.health.mismatch = found

    def reset(self) -> None:
        """Restart after a time jump."""
        self._intake.reset(self._clock.now())
        self._report_change()

    def restart(self) -> None:
        """Begin anew after a failure, which may have left an estimator half changed: nothing is published meanwhile."""
        self._failures += 1
        self._failing_since = self._failing_since or monotonic()
        self._intake.restart()
        self._report_change()

    def detail(self) -> str:
        """Return details of the damper's reason, including the state of a silent topic."""
        detail = self.damper.explain()
        names = {SILENT: "position", NO_CURRENT: "current", NO_MOTION: self.damper.motion_name}
        if detail or self.damper.reason not in names:
            return detail
        silent = self.settings.signals[names[self.damper.reason]]
        if isinstance(silent, Constant):
            return ""
        topic = self._node.resolve_topic_name(silent.topic)
        types = sorted({info.topic_type for info in self._node.get_publishers_info_by_topic(topic)})
        if not types:
            return f"nothing publishes {topic}"
        if silent.type not in types:
            return f"{topic} carries {', '.join(types)}; {silent.name}.type is {silent.type}"
        return f"{topic} has a publisher that is silent"

    def _close(self) -> None:
        """Withdraw the topics of the estimates."""
        for output in (self._now, self._late):
            if output is not None:
                output.close()

    def _offer_late(self) -> None:
        """Offer the topics of the delayed estimates while a model with a delay runs or is about to."""
        models = (self.damper.model, self.damper.next_model)
        if not any(model is not None and model.sampling.delay_ticks for model in models):
            late, self._late = self._late, None
            if late is not None:
                late.close()
        elif self._late is None:
            name, topics = self.settings.name, self.settings.topics
            self._late = EstimateOutput(self._node, name, f"{topics}estimate_delayed")

    def _make_cost(self) -> RunningCost:
        warn_J = live_value(self._node, self.settings.prefix, "cost_warn_J")
        return RunningCost.from_model(self.damper.model, warn_J or None, self.settings.values["cost_window_s"])

    def _subscribe(self) -> None:
        """Subscribe, to the position last: what else its message carries holds for it."""
        health, damper, settings = self.health, self.damper, self.settings

        def subscribe(name: str, deliver: Deliver, on_unreadable: Callable[[str], None]) -> Arrivals:
            signal = settings.signals[name]
            if isinstance(signal, Constant):
                return Arrivals()
            self._subscribed.append(signal)
            stamped = self._inputs.subscribe(signal, deliver, on_unreadable, self.restart)
            if not stamped:
                self._node.get_logger().warning(
                    f"signal '{settings.prefix}{name}': {signal.type} has no header; samples are stamped with their "
                    "arrival"
                )
            return Arrivals(stamped, self._inputs.losses_of(signal))

        health.current = subscribe("current", self._on_current, partial(damper.count_unreadable, "current"))
        for name in damper.motions:
            subscribe(name, partial(self._on_motion, name), partial(damper.count_unreadable, "motion"))
        health.position = subscribe("position", self._on_position, partial(damper.count_unreadable, "position"))
        health.force = subscribe("force", self._node.guard.wrap(self._on_measured_force), lambda error: None)

    def _on_current(self, stamp_ns: int, current_A: float, frame: bytes, now_ns: int) -> None:
        del frame
        self._note_current(stamp_ns, now_ns)
        self._intake.take_current(stamp_ns, current_A, now_ns)

    def _on_motion(self, name: str, stamp_ns: int, value: float, frame: bytes, now_ns: int) -> None:
        del frame
        self._intake.take_motion(name, stamp_ns, value, now_ns)

    def _on_position(self, stamp_ns: int, position_m: float, frame: bytes, now_ns: int) -> None:
        self._note_position(stamp_ns, position_m, now_ns)
        self._intake.take_position(stamp_ns, position_m, frame, now_ns)

    def _on_measured_force(self, stamp_ns: int, force_N: float, frame: bytes, now_ns: int) -> None:
        del frame
        health = self.health
        if health.cost is None:
            self._on_first_force(self)
        health.force.take(stamp_ns, now_ns)
        if health.cost is not None:
            health.cost.add_measured(stamp_ns, force_N)

    def _publish(self, stamp_ns: int, frame: bytes, force: float | None) -> None:
        damper, is_active = self.damper, self._node.is_active
        if force is not None and is_active:
            half_width = damper.half_width() if self._now.has_band_listeners else None
            self._now.publish(stamp_ns, frame, damper.position, damper.speed, force, half_width)
            self._note_force(stamp_ns, force)
        if damper.late and is_active and self._late is not None:
            for one in damper.late:
                self._late.publish(one.stamp_ns, frame, *one[1:])
                self._note_force(one.stamp_ns, one.force)
        if damper.reason != self._reported_reason:
            self._report_change()
        self._failing_since = None

    def _count_position(self, stamp_ns: int, position_m: float, now_ns: int) -> None:
        self.health.position.take(stamp_ns, now_ns)
        self.health.stillness.take(stamp_ns, position_m)

    def _count_current(self, stamp_ns: int, now_ns: int) -> None:
        self.health.current.take(stamp_ns, now_ns)

    def _count_force(self, stamp_ns: int, force_N: float) -> None:
        self.health.latency.take(self._clock.now() - stamp_ns)
        if self.health.cost is not None:
            self.health.cost.add_estimate(stamp_ns, force_N)

    def _report_change(self) -> None:
        if self.damper.reason != self._reported_reason:
            self._reported_reason = self.damper.reason
            self.health.note_change(self._clock.now())
            self._on_change()
