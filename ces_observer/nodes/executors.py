"""What runs a node: its executor, its clock, and the main function of every node."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence

import rclpy
from rclpy.clock import Clock, ClockChange, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.qos_overriding_options import InvalidQosOverridesError

from ces_observer.arrival_clock import ClockWatch
from ces_observer.errors import CesError
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.parameter_table import EXECUTOR
from ces_observer.nodes.rclpy_gaps import EventsExecutor, freeze_objects

BACKWARD = Duration(nanoseconds=-1_000_000)
# The steps of /clock in a fast replay are no jumps. The samples' stamps show shorter jumps.
FORWARD = Duration(seconds=5)
# Arguments of a logger's method for lines on jumps: each is in the diagnostics.
RARELY = {"throttle_duration_sec": 5.0, "throttle_time_source_type": Clock(clock_type=ClockType.STEADY_TIME)}
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
        clock = self._clock
        self.now: Callable[[], int] = (lambda: int(clock.now().nanoseconds)) if self.is_simulated else time.time_ns

    def _on_ros_jump(self, jump: TimeJump) -> None:
        self._choose_clock()
        if jump.clock_change not in CHANGES and self.now() == jump.delta.nanoseconds:
            return
        seconds = jump.delta.nanoseconds * 1e-9
        self._on_jump(CHANGES.get(jump.clock_change, f"simulated time jumped by {seconds:+.3f} s"))


AUTO, EVENTS, SINGLE = EXECUTOR.choices
USER_ERROR = 2
PAUSE_S = 0.001  # before rclpy's executor is spun again: a lasting error must not take the whole processor
END_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# Raised by a wrong parameter, name or QoS while a node is built; rcl's own errors are RuntimeErrors.
START_ERRORS = (CesError, ParameterException, NameValidationException, InvalidQosOverridesError, RuntimeError)


def run(name: str, make: Callable[[], GuardedNode], argv: Sequence[str] | None = None) -> int:
    """Build the node `name` with `make`, start and run it; returns the program's exit status.

    That is 0 after a signal, or 2 with one FATAL line after one of START_ERRORS. The node's attribute
    `executor_choice`, a value of EXECUTOR, selects the executor; the default is `auto`.
    """
    ends: list[int] = []
    for number in END_SIGNALS:
        # rclpy shuts down on these by itself. Python's KeyboardInterrupt could interrupt any statement, and a second
        # SIGINT, as ros2 launch sends, would kill the interpreter during shutdown.
        signal.signal(number, lambda number, frame: ends.append(number))
    try:
        try:
            rclpy.init(args=None if argv is None else list(argv))
            node = make()
            node.start()
            executor = make_executor(getattr(node, "executor_choice", AUTO))
        except START_ERRORS as error:
            if ends:  # the signal has shut down the context during the start
                return 0
            get_logger(name).fatal(str(error).splitlines()[0])
            return USER_ERROR
        if not ends:
            _spin(node, executor)
        return 0
    finally:
        rclpy.try_shutdown()
        for number in END_SIGNALS:
            signal.signal(number, signal.SIG_IGN)


def make_executor(choice: str) -> Executor:
    """Return a new executor for `choice`; raises CesError if it is unknown or this rclpy has no such executor."""
    EXECUTOR.check_parameter(choice)
    if choice == EVENTS and EventsExecutor is None:
        raise CesError("parameter 'executor' is 'events'; this rclpy has no EventsExecutor: set auto or single")
    return SingleThreadedExecutor() if is_single(choice) else EventsExecutor()


def is_single(choice: str) -> bool:
    """Return whether `choice` gives a SingleThreadedExecutor, which takes one message of a topic at a time."""
    return choice == SINGLE or EventsExecutor is None


def spin_on(node: GuardedNode, spin: Callable[[], None]) -> None:
    """Call `spin` until it returns or the context is shut down; an error in rclpy itself is one for the guard."""
    while node.context.ok():
        try:
            spin()
            return
        except ExternalShutdownException:
            return
        except Exception as error:
            node.guard.take(error)
            time.sleep(PAUSE_S)


def _spin(node: GuardedNode, executor: Executor) -> None:
    executor.add_node(node)
    freeze_objects()
    try:
        spin_on(node, executor.spin)
    finally:
        executor.shutdown()
        node.destroy_node()
