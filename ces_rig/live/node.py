"""The rig node: commanded valve current goes in; position, coil current and force come out as on a vehicle.

In real time a steady timer makes the samples that are due; after a stall all of them follow, each with its own stamp.
With `publish_clock` the node generates the time: at a factor of real time, or as fast as its readers allow.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from time import monotonic

from rclpy.parameter import Parameter

from ces_data.compilation import CompilationNotice
from ces_observer.health.health import LEVEL_OK, Report, Status
from ces_observer.nodes.executors import collect_garbage, run
from ces_observer.nodes.outputs import DamperReport, DiagnosticsOutput, add_remark
from ces_observer.nodes.parameters import TableNode, declare_table
from ces_rig import drive as qv
from ces_rig.errors import RigError
from ces_rig.live.rig import (
    LIVE,
    OF_THE_NODE,
    OF_THE_RIG,
    SET_POINTS,
    VEHICLE,
    LiveRig,
    RigNodeSettings,
    RigSettings,
    read_settings,
)
from ces_rig.live.timing import Lockstep, Pace
from ces_rig.live.topics import RigTopics

SECOND_NS = 1_000_000_000
CLOCK_START_NS = SECOND_NS  # of simulated time; in ROS, 0 means that there is no time yet
AT_ONCE = 50  # ticks between two checks for commands
LAG_S = 0.1  # lag above which the node warns
DRIFT_S = 0.01  # drift of the system clock from the steady clock above which the stamps are corrected
IDLE_S = 1e-3  # period of the timer when the readers of the samples set the pace
MIN_PERIOD_S = 1e-4


class Rig(TableNode):
    """The node `rig`; raises one of executors.START_ERRORS if it cannot start."""

    MAY_BE_EMPTY = frozenset({"withheld"})

    def __init__(self) -> None:
        super().__init__("rig")
        own, settings = declare_settings(self)
        self.executor_choice = own.executor
        CompilationNotice(self.get_logger().info)
        LiveRig(settings).tick()  # compiles the kernels, so that compilation delays no sample
        self._own, self._rig = own, LiveRig(settings)
        self._free = own.publish_clock and own.real_time_factor == 0.0
        self._lockstep = Lockstep(own.answer_s, monotonic()) if self._free and own.answer_s > 0.0 else None
        self._topics = RigTopics(self, own, self._on_command, settings.drive == VEHICLE, keep_all=self._free)
        self._diagnostics = DiagnosticsOutput(self)
        if settings.drive == SET_POINTS:
            self._topics.listen_to_strokes(self._rig.follower.set_stroke)
        self.refuse_parameters(lambda changed: self._rig.check(_live_values(changed)))
        self.add_post_set_parameters_callback(lambda changed: self._rig.change(_live_values(changed)))
        self._blows = self._refused = self._unasked = 0
        factor = own.real_time_factor if own.publish_clock else 1.0
        self._begin_s = monotonic()
        self._first_ns = CLOCK_START_NS if own.publish_clock else self.get_clock().now().nanoseconds
        self._pace = Pace(self._rig.period_s, self._begin_s, factor or 1.0)
        idle_s = IDLE_S if self._lockstep else MIN_PERIOD_S
        period_s = max(self._rig.period_s / factor, MIN_PERIOD_S) if factor else idle_s
        self.create_steady_timer(period_s, self._follow if self._free else self._keep_pace)
        self.create_steady_timer(1.0, self._watch)

    def _keep_pace(self) -> None:
        """Make the samples that are due, at most AT_ONCE before the next check for commands."""
        for _ in range(min(self._pace.count_due(monotonic()), AT_ONCE)):
            self._tick()
            self._pace.mark_done()

    def _follow(self) -> None:
        """Make samples as fast as the readers allow, or without waiting while an answer is overdue."""
        if self._lockstep:
            if self._lockstep.is_due_idle(monotonic()):
                self._tick()
            return
        for _ in range(AT_ONCE):  # a reliable reader that keeps all messages blocks `publish`
            self._tick()

    def _tick(self) -> None:
        sample = self._rig.tick()
        if self._lockstep:
            self._lockstep.mark_sample(monotonic())
        self._topics.publish(sample, self._first_ns + sample.tick * SECOND_NS // self._rig.settings.rate_hz)

    def _on_command(self, current_A: float) -> None:
        self._rig.command.set_current(current_A, self._rig.time_s)
        if self._lockstep and self._lockstep.take_command():
            self._tick()

    def _watch(self) -> None:
        """Check clocks and report problems, once a second."""
        collect_garbage()
        for check in (self._look_for_commander, self._follow_clock, self._warn_of_lag, self._warn_of_events):
            self.guard.call(check)
        self._publish_status()

    def _look_for_commander(self) -> None:
        """Look for one, and warn if it sends commands that answer no sample."""
        if not self._lockstep:
            return
        self._lockstep.find_commander(self._topics.is_commanded())
        if self._lockstep.unasked > self._unasked:
            self._unasked = self._lockstep.unasked
            self.get_logger().warning(
                f"commands come without samples, so samples may not wait for their answers; set the controller's "
                f"timeout_s above answer_s ({self._own.answer_s:g} s)"
            )

    def _follow_clock(self) -> None:
        """Keep the stamps on the system clock when it is set or drifts away from the steady clock."""
        if self._own.publish_clock:
            return
        off_ns = self.get_clock().now().nanoseconds - self._first_ns - int((monotonic() - self._begin_s) * SECOND_NS)
        if abs(off_ns) > DRIFT_S * SECOND_NS:
            self.get_logger().warning(f"the system clock moved by {off_ns * 1e-9:.3f} s; the stamps follow it")
            self._first_ns += off_ns

    def _warn_of_lag(self) -> None:
        lag_s = 0.0 if self._free else self._pace.lag_s(monotonic())
        if lag_s > LAG_S:
            self.get_logger().warning(
                f"{lag_s:.2f} s behind: samples are late but correctly stamped; lower rate_hz or free the processor"
            )

    def _warn_of_events(self) -> None:
        blows, refused = int(self._rig.motion[qv.BLOWS]), self._rig.command.refused
        if blows > self._blows:
            self.get_logger().warning(
                f"the damper bottomed out {blows - self._blows} times in a second (metal contact)"
            )
        if refused > self._refused:
            self.get_logger().warning(f"{refused - self._refused} commands refused: not finite")
        self._blows, self._refused = blows, refused

    def _publish_status(self) -> None:
        counts = ("samples", str(self._rig.ticks)), ("commands refused", str(self._rig.command.refused))
        values = (*counts, *self.guard.values())
        status = add_remark(Status(LEVEL_OK, "running", values), self.guard.take_remark())
        self._diagnostics.publish([DamperReport(self._own.joint, self._own.joint, Report("running", status))])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; return 0 when stopped by a signal, 2 for an unusable parameter."""
    return run("rig", Rig, argv)


def declare_settings(node: TableNode) -> tuple[RigNodeSettings, RigSettings]:
    """Declare and read all parameters; raises CesError or rclpy's ParameterException."""
    own, rig = read_settings(declare_table(node, (*OF_THE_NODE, *OF_THE_RIG)))
    if node.get_parameter("use_sim_time").value and not own.publish_clock:
        raise RigError("use_sim_time is true, but the rig is the source of time; set publish_clock: true, or neither")
    return own, rig


def _live_values(parameters: Sequence[Parameter]) -> dict[str, object]:
    return {parameter.name: parameter.value for parameter in parameters if parameter.name in LIVE}


if __name__ == "__main__":
    sys.exit(main())
