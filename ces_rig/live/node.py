"""The rig node: commanded valve current goes in; position, coil current and force come out as on a vehicle.

In real time a steady timer makes the samples that are due; after a stall all of them follow, each with its own stamp.
With `publish_clock` the node generates the time: at a factor of real time, or as fast as its readers allow. A message
with a header and one number is serialised once and patched for each sample: a third of the cost of publishing as usual.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable, Sequence
from functools import partial
from operator import setitem
from time import monotonic
from typing import Any

from geometry_msgs.msg import AccelStamped, WrenchStamped
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from ces_data.compilation import CompilationNotice
from ces_observer.health.diagnostics import LEVEL_OK, Report, Status
from ces_observer.nodes.executors import run
from ces_observer.nodes.outputs import DamperReport, DiagnosticsOutput, add_remark
from ces_observer.nodes.parameters import TableNode, declare_table
from ces_rig import drive as qv
from ces_rig.errors import RigError
from ces_rig.limits import LiveLimits
from ces_rig.live.rig import (
    LIVE,
    OF_THE_NODE,
    OF_THE_RIG,
    SET_POINTS,
    VEHICLE,
    LiveRig,
    RigNodeSettings,
    RigSample,
    RigSettings,
    read_settings,
)
from ces_rig.live.timing import Lockstep, Pace

SECOND_NS = 1_000_000_000
CLOCK_START_NS = SECOND_NS  # of simulated time; in ROS, 0 means that there is no time yet
AT_ONCE = 50  # ticks between two checks for commands
IDLE_S = 1e-3  # period of the timer when the readers of the samples set the pace
MIN_PERIOD_S = 1e-4


STAMP, NUMBER = struct.Struct("<iI"), struct.Struct("<d")
PROBE = (1_234_567_890, 987_654_321, 0.123456789)  # their places in the bytes are the places to patch


class PatchedMessage:
    """Publishes `message` with a new stamp and number each time; `set_number` writes a number into it."""

    def __init__(self, publisher: Publisher, message: Any, set_number: Callable[[float], None]) -> None:
        self._publish = publisher.publish
        message.header.stamp.sec, message.header.stamp.nanosec = PROBE[:2]
        set_number(PROBE[2])
        self._bytes = bytearray(serialize_message(message))
        self._stamp_at = self._bytes.index(STAMP.pack(*PROBE[:2]))
        self._number_at = self._bytes.index(NUMBER.pack(PROBE[2]))

    def publish(self, sec: int, nanosec: int, number: float) -> None:
        """Publish a number with a stamp."""
        STAMP.pack_into(self._bytes, self._stamp_at, sec, nanosec)
        NUMBER.pack_into(self._bytes, self._number_at, number)
        self._publish(bytes(self._bytes))


DEPTH = 100  # a tenth of a second at 1 kHz


class RigTopics:
    """Publishers and the subscription of one rig; with `keep_all`, a full history blocks the publisher."""

    def __init__(
        self, node: Node, settings: RigNodeSettings, on_command: Callable[[float], None], vehicle: bool, keep_all: bool
    ) -> None:
        self._node = node
        self._joint = joint = settings.joint
        self._history = HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST
        joints = JointState(name=[joint], position=[0.0])
        self._position = self._make_patched("joint_states", joints, partial(setitem, joints.position, 0))
        self._force = self._make_wrench("measured_force")
        current, self._plain_current = JointState(name=[joint], effort=[0.0]), Float64()
        self._current: Callable[[int, int, float], None]
        if settings.stamped_current:
            self._current = self._make_patched("valve_current", current, partial(setitem, current.effort, 0)).publish
        else:
            self._plain_currents = self._publisher(Float64, "valve_current")
            self._current = self._publish_plain_current
        body = AccelStamped()
        set_body = partial(setattr, body.accel.linear, "z")
        self._body = self._make_patched("body_acceleration", body, set_body) if vehicle else None
        self._tyre = self._make_wrench("tyre_load") if vehicle else None
        self._clocks = node.create_publisher(Clock, "/clock", 10) if settings.publish_clock else None
        self._clock = Clock()
        self._commands = self._subscribe("valve_command", on_command)

    def publish(self, sample: RigSample, stamp_ns: int) -> None:
        """Publish the sample of `stamp_ns`: the clock first, the position last, after the signals used with it."""
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        if self._clocks is not None:
            self._clock.clock.sec, self._clock.clock.nanosec = sec, nanosec
            self._clocks.publish(self._clock)
        if sample.current_A is not None:
            self._current(sec, nanosec, sample.current_A)
        if sample.force_N is not None:
            self._force.publish(sec, nanosec, sample.force_N)
        if self._body is not None and self._tyre is not None:
            self._body.publish(sec, nanosec, sample.body_m_s2)
            self._tyre.publish(sec, nanosec, sample.tyre_N)
        if sample.position_m is not None:
            self._position.publish(sec, nanosec, sample.position_m)

    def listen_to_strokes(self, on_stroke: Callable[[float], None]) -> None:
        """Subscribe to the set points of the stroke [m]."""
        self._strokes = self._subscribe("stroke_command", on_stroke)

    def is_commanded(self) -> bool:
        """Return whether any node publishes commands."""
        return bool(self._commands.get_publisher_count() > 0)

    def _make_wrench(self, topic: str) -> PatchedMessage:
        message = WrenchStamped()
        return self._make_patched(topic, message, partial(setattr, message.wrench.force, "z"))

    def _make_patched(self, topic: str, message: Any, set_number: Callable[[float], None]) -> PatchedMessage:
        message.header.frame_id = self._joint
        return PatchedMessage(self._publisher(type(message), topic), message, set_number)

    def _publish_plain_current(self, sec: int, nanosec: int, current_A: float) -> None:
        """Publish a current without its stamp."""
        self._plain_current.data = current_A
        self._plain_currents.publish(self._plain_current)

    def _publisher(self, kind: type, topic: str) -> Publisher:
        qos = QoSProfile(depth=DEPTH, history=self._history)
        options = QoSOverridingOptions.with_default_policies()
        return self._node.create_publisher(kind, topic, qos, qos_overriding_options=options)

    def _subscribe(self, topic: str, on_number: Callable[[float], None]) -> Subscription:
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        options = QoSOverridingOptions.with_default_policies()
        return self._node.create_subscription(
            Float64, topic, lambda message: on_number(message.data), qos, qos_overriding_options=options
        )


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
        if abs(off_ns) > LiveLimits.MAX_DRIFT_S * SECOND_NS:
            self.get_logger().warning(f"the system clock moved by {off_ns * 1e-9:.3f} s; the stamps follow it")
            self._first_ns += off_ns

    def _warn_of_lag(self) -> None:
        lag_s = 0.0 if self._free else self._pace.lag_s(monotonic())
        if lag_s > LiveLimits.MAX_LAG_S:
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
