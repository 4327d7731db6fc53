"""The rig node: commanded valve current in, position, coil current and force out, sample by sample, as on a vehicle.

In real time a steady timer asks how many samples are due, and after a stall they all follow, each with its own stamp.
With `publish_clock` the node makes time itself: at a factor, or as fast as its samples are taken.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from time import monotonic

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

from ces_observer.nodes.executors import collect_garbage, run
from ces_observer.nodes.node_parameters import TableNode, declare_table
from ces_rig.drive import vehicle_kernel as qv
from ces_rig.errors import RigError
from ces_rig.live.node_table import OF_THE_NODE, OF_THE_RIG, RigNodeSettings, read_settings
from ces_rig.live.pace import Pace
from ces_rig.live.rig import LIVE, VEHICLE, LiveRig, RigSettings
from ces_rig.live.topics import RigTopics

SECOND_NS = 1_000_000_000
CLOCK_START_NS = SECOND_NS  # of simulated time: 0 means to ROS that there is no time yet
AT_ONCE = 50  # ticks before commands are listened to again
LAG_S = 0.1  # behind which the node warns
DRIFT_S = 0.01  # of the system's clock from the steady one, after which stamps follow it
IDLE_S = 1e-3  # period of the timer when it is the samples' readers that set the pace
SOONEST_S = 1e-4
QUIET = 1000  # of these idle periods without a command, and no answer to earlier samples is on its way


class Rig(TableNode):
    """The node `rig`; raises what executors.START_ERRORS lists if it cannot be built."""

    MAY_BE_EMPTY = frozenset({"withheld"})

    def __init__(self) -> None:
        super().__init__("rig")
        own, settings = declare_settings(self)
        self.executor_choice = own.executor
        self._own, self._rig = own, _build_rig(settings, self)
        self._free = own.publish_clock and own.real_time_factor == 0.0
        self._answers = self._free and own.answer_s > 0.0
        self._topics = RigTopics(
            self,
            own.joint,
            self._on_command,
            vehicle=settings.drive == VEHICLE,
            stamped=own.stamped_current,
            clock=own.publish_clock,
            keep_all=self._free,
        )
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)
        self._sample_s, self._blows, self._refused, self._commanded = monotonic(), 0, 0, False
        self._adrift = False  # whether an answer is overdue: samples come unasked for until there is one
        self._quiet = 0  # idle periods since a commander appeared, or since its last command before samples wait for it
        self._start()

    def _start(self) -> None:
        factor = self._own.real_time_factor if self._own.publish_clock else 1.0
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._begin_s = monotonic()
        self._first_ns = CLOCK_START_NS if self._own.publish_clock else self.get_clock().now().nanoseconds
        self._pace = Pace(self._rig.period_s, self._begin_s, factor or 1.0)
        period_s = max(self._rig.period_s / factor, SOONEST_S) if factor else IDLE_S if self._answers else SOONEST_S
        self.create_timer(period_s, self._follow if self._free else self._keep_pace, clock=steady)
        self.create_timer(1.0, self._watch, clock=steady)

    def _keep_pace(self) -> None:
        """Make the samples that are due; more than AT_ONCE wait until commands have been heard."""
        for _ in range(min(self._pace.count_due(monotonic()), AT_ONCE)):
            self._tick()
            self._pace.mark_done(1)

    def _follow(self) -> None:
        """Make samples as fast as they are taken, or unasked for while an answer is overdue."""
        if self._answers:
            self._quiet += 1
            self._adrift = self._adrift or (self._waits and self._is_overdue)
            if not self._commanded or self._adrift or self._quiet == QUIET:
                self._tick()
            return
        for _ in range(AT_ONCE):  # a reader that keeps all of a reliable topic holds `publish` up
            self._tick()

    def _tick(self) -> None:
        sample = self._rig.tick()
        self._sample_s = monotonic()
        try:
            self._topics.publish(sample, self._first_ns + sample.tick * SECOND_NS // self._rig.settings.rate_hz)
        except RuntimeError:
            if self.context.ok():  # otherwise a signal came in between
                raise

    @property
    def _waits(self) -> bool:
        """Whether every answer to samples made before they waited for answers has come."""
        return self._quiet >= QUIET

    @property
    def _is_overdue(self) -> bool:
        return monotonic() - self._sample_s > self._own.answer_s

    def _on_command(self, current_A: float) -> None:
        self._rig.command.set_current(current_A, self._rig.time_s)
        if self._answers and self._commanded:
            if self._waits and not self._adrift:
                self._tick()
            else:
                self._adrift, self._quiet = False, 0

    def _watch(self) -> None:
        """Once a second: clocks, and what went wrong meanwhile."""
        collect_garbage()
        self._look_for_commander()
        if not self._own.publish_clock:
            self._follow_clock()
        if not self._free:
            self._warn_of_lag()
        self._warn_of_events()

    def _look_for_commander(self) -> None:
        """When one appears, let the answers to earlier samples pass, or each would call for a sample ever after."""
        before, self._commanded = self._commanded, self._topics.is_commanded()
        if self._commanded and not before:
            self._adrift, self._quiet = False, 0

    def _follow_clock(self) -> None:
        """Keep the stamps on the system's clock when that is set or drifts away from the steady one."""
        off_ns = self.get_clock().now().nanoseconds - self._first_ns - int((monotonic() - self._begin_s) * SECOND_NS)
        if abs(off_ns) > DRIFT_S * SECOND_NS:
            self.get_logger().warning(f"the system's clock went {off_ns * 1e-9:.3f} s off; stamps follow it")
            self._first_ns += off_ns

    def _warn_of_lag(self) -> None:
        lag_s = self._pace.lag_s(monotonic())
        if lag_s > LAG_S:
            self.get_logger().warning(
                f"{lag_s:.2f} s behind: samples come late, with true stamps; lower rate_hz or free the processor"
            )

    def _warn_of_events(self) -> None:
        blows, refused = int(self._rig.motion[qv.BLOWS]), self._rig.command.refused
        if blows > self._blows:
            self.get_logger().warning(f"the damper bottomed {blows - self._blows} times in a second, metal on metal")
        if refused > self._refused:
            self.get_logger().warning(f"{refused - self._refused} commands were no finite number and refused")
        self._blows, self._refused = blows, refused

    def _check_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            self._rig.check(_live_values(parameters))
        except RigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_parameters(self, parameters: Sequence[Parameter]) -> None:
        self._rig.change(_live_values(parameters))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; returns 0 when stopped by a signal, 2 if a parameter cannot be used."""
    return run("rig", Rig, argv)


def declare_settings(node: Node) -> tuple[RigNodeSettings, RigSettings]:
    """Declare and read all parameters; raises CesError or rclpy's ParameterException."""
    own, rig = read_settings(declare_table(node, (*OF_THE_NODE, *OF_THE_RIG)))
    if node.get_parameter("use_sim_time").value and not own.publish_clock:
        raise RigError(
            "use_sim_time is true, but the rig makes time itself; set publish_clock: true as well, or neither"
        )
    return own, rig


def _live_values(parameters: Sequence[Parameter]) -> dict[str, object]:
    return {parameter.name: parameter.value for parameter in parameters if parameter.name in LIVE}


def _build_rig(settings: RigSettings, node: Node) -> LiveRig:
    """Return the rig at rest, its kernels compiled, so that no sample is late for that."""
    begin = monotonic()
    LiveRig(settings).tick()
    took = monotonic() - begin
    if took > 5.0:
        node.get_logger().info(f"compiled in {took:.0f} s; the next start takes it from the cache")
    return LiveRig(settings)


if __name__ == "__main__":
    sys.exit(main())
