"""The node's time in nanoseconds, fast to read, and callbacks on jumps of simulated time or the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import ClockChange, JumpThreshold, TimeJump
from rclpy.duration import Duration

from ces_observer.clock_watch import ClockWatch
from ces_observer.nodes.guarded_node import GuardedNode

BACKWARD = Duration(nanoseconds=-1_000_000)
# The steps of /clock in a fast replay are no jumps. The samples' stamps show shorter jumps.
FORWARD = Duration(seconds=5)
CHANGES = {
    ClockChange.ROS_TIME_ACTIVATED: "simulated time was switched on",
    ClockChange.ROS_TIME_DEACTIVATED: "simulated time was switched off",
}


class NodeClock:
    """`now()` is the node's time [ns]; `on_jump` is called with a line of text after each time jump.

    Simulated time is 0 until its first /clock message, which is no jump: samples may arrive before it.
    """

    def __init__(self, node: GuardedNode, on_jump: Callable[[str], None]) -> None:
        self._clock = node.get_clock()
        self._on_jump = on_jump
        self._wall = ClockWatch(time.time_ns(), time.monotonic_ns())
        self._choose_clock()
        threshold = JumpThreshold(min_forward=FORWARD, min_backward=BACKWARD, on_clock_change=True)
        self._jumps = self._clock.create_jump_callback(threshold, post_callback=node.guard.wrap(self._on_ros_jump))

    def watch(self) -> None:
        """Check whether the wall clock was set: rclpy reports only jumps of simulated time."""
        jump_ns = self._wall.measure_jump(time.time_ns(), time.monotonic_ns())
        if jump_ns and not self.is_simulated:
            self._on_jump(f"the wall clock was set by {jump_ns * 1e-9:+.3f} s")

    def close(self) -> None:
        """Remove the callback."""
        self._jumps.unregister()

    def _choose_clock(self) -> None:
        self.is_simulated = bool(self._clock.ros_time_is_active)
        self.now: Callable[[], int] = self._simulated_now if self.is_simulated else time.time_ns

    def _simulated_now(self) -> int:
        return int(self._clock.now().nanoseconds)

    def _on_ros_jump(self, jump: TimeJump) -> None:
        self._choose_clock()
        if jump.clock_change not in CHANGES and self.now() == jump.delta.nanoseconds:
            return
        seconds = jump.delta.nanoseconds * 1e-9
        self._on_jump(CHANGES.get(jump.clock_change, f"simulated time jumped by {seconds:+.3f} s"))
