"""The node `identify`: runs `ces identify`, and publishes its progress and the costs of the model that it has written.

The search runs in a separate process; a timer polls its messages. The first Ctrl-C or SIGTERM stops the search, writes
the best model so far and ends the node; a second one ends the node at once.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from time import monotonic
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from ces_cli.identify.process import DONE, EXIT_STATUS, SEARCHING, WARNING, WRITING, IdentifyProcess, SearchState
from ces_cli.identify.request import EXIT_WHEN_DONE, PARAMETERS, find_given_parameters
from ces_observer.nodes.executors import START_ERRORS, USER_ERROR, spin_on
from ces_observer.nodes.outputs import LATCHED
from ces_observer.nodes.parameters import TableNode, declare_table

POLL_S = 0.1
PROGRESS_PERIOD_S = 1.0  # period of ~/progress while nothing changes
LOG_S = 5.0
SIGNAL_MERGE_S = 2.0  # a terminal and ros2 launch both forward the same Ctrl-C
ACKNOWLEDGE_TIMEOUT = Duration(seconds=1)
SIGNALS = ("position", "current", "force")  # a parameter file for several nodes may describe them


class StopRequests:
    """Counts the requests to stop; signals in quick succession are one request."""

    def __init__(self) -> None:
        self.count = 0
        self._last_s = float("-inf")

    def __call__(self, number: int, frame: object) -> None:
        """Handle a signal."""
        now = monotonic()
        self.count += now - self._last_s > SIGNAL_MERGE_S
        self._last_s = now


class IdentifyNode(TableNode):
    """The node; `status` is the future exit status. Raises the START_ERRORS if it cannot be built."""

    def __init__(self, stop: StopRequests) -> None:
        super().__init__("identify")
        values = declare_table(self, (*PARAMETERS, EXIT_WHEN_DONE), SIGNALS)
        self._exits = values[EXIT_WHEN_DONE.name]
        self.status: Future = Future()
        self._stop, self._handled_stops = stop, 0
        self._progress = self.create_publisher(DiagnosticArray, "~/progress", LATCHED)
        self._result = self.create_publisher(DiagnosticArray, "~/result", LATCHED)
        self._state = SearchState()
        self._published_s = self._logged_s = float("-inf")
        self.create_timer(POLL_S, self._poll, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._process: IdentifyProcess | None = IdentifyProcess(find_given_parameters(values))

    def end(self) -> None:
        """End the search if it is running, and wait until subscribers have the last messages."""
        if self._process is not None:
            self._process.end()
        self._result.wait_for_all_acked(ACKNOWLEDGE_TIMEOUT)

    def _poll(self) -> None:
        """Handle the user's requests to stop and the messages of the search; one that cannot be used stops no other."""
        handle = self.guard.wrap(self._handle_message)
        if self._process is not None:
            for message in self._process.read_messages():
                handle(message)
        if self._stop.count > self._handled_stops:
            self._handled_stops = self._stop.count
            self._handle_stop_request()
        if self._state.changed or (self._process is not None and monotonic() - self._published_s >= PROGRESS_PERIOD_S):
            self._publish_progress()

    def _handle_message(self, message: dict[str, Any]) -> None:
        if WARNING in message:
            self.get_logger().warning(message[WARNING])
        elif "result" in message:
            self._publish_result(message["result"])
        elif EXIT_STATUS in message:
            self._process = None
            self._handle_exit(message[EXIT_STATUS])
        else:
            self._state.update(message)

    def _handle_stop_request(self) -> None:
        if self._process is None:
            self._finish(0)
        elif self._handled_stops > 1 or self._state.stage not in (SEARCHING, WRITING):
            self.get_logger().warning("stopped without a model; nothing was written")
            self._finish(0)
        else:
            self.get_logger().info("stopping with the best model so far; press Ctrl-C again to stop without a model")
            if self._state.stage == SEARCHING:
                self._process.interrupt()

    def _publish_progress(self) -> None:
        """Publish the progress; log a new stage at once, the costs of the search every few seconds."""
        now = monotonic()
        line, values = self._state.as_status()
        name = f"{self.get_fully_qualified_name()}: progress"
        message = DiagnosticArray(status=[_status(name, line, {**values, **dict(self.guard.values())})])
        message.header.stamp = self.get_clock().now().to_msg()
        self._progress.publish(message)
        if self._state.changed_stage or now - self._logged_s >= LOG_S:
            self.get_logger().info(message.status[0].message)
            self._logged_s = now
        self._published_s = now
        self._state.clear_changes()

    def _publish_result(self, result: dict[str, Any]) -> None:
        name = self.get_fully_qualified_name()
        message = DiagnosticArray(status=[_status(f"{name}: model", "identified", result["facts"])])
        for cost in result["costs"]:
            line = f"J = {cost['J [%]']} %, {cost['role']}"
            message.status.append(_status(f"{name}: {cost['recording']}", line, cost))
            self.get_logger().info(f"{cost['recording']}: {line}")
        message.header.stamp = self.get_clock().now().to_msg()
        self._result.publish(message)
        self.get_logger().info(f"model: {result['facts']['model']}")
        self._state.update({"stage": DONE})

    def _handle_exit(self, status: int) -> None:
        if self._state.stage == DONE:
            if self._exits or self._handled_stops:
                self._finish(0)
        elif self._handled_stops:
            self.get_logger().warning(f"stopped without a model: {self._state.error or 'the search had no model yet'}")
            self._finish(0)
        else:
            reason = f"exited with status {status}; see above"
            if status == -signal.SIGKILL:
                reason = "was killed, as the kernel does when memory is short; set fewer threads"
            self.get_logger().fatal(self._state.error or f"the search process {reason}")
            self._finish(USER_ERROR)

    def _finish(self, status: int) -> None:
        if not self.status.done():
            self.status.set_result(status)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; returns 0 when done or stopped by a signal, 2 if a parameter or a recording cannot be used."""
    stop = StopRequests()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        # rclpy's own handlers would shut the context down before the costs of the best model so far could be published.
        rclpy.init(args=None if argv is None else list(argv), signal_handler_options=SignalHandlerOptions.NO)
        return _run(stop)
    except START_ERRORS as error:
        get_logger("identify").fatal(str(error).splitlines()[0])
        return USER_ERROR
    finally:
        rclpy.try_shutdown()
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run(stop: StopRequests) -> int:
    node = IdentifyNode(stop)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        spin_on(node, lambda: executor.spin_until_future_complete(node.status))
        return int(node.status.result()) if node.status.done() else 0
    finally:
        node.guard.call(node.end)
        executor.shutdown()


def _status(name: str, message: str, values: dict[str, str]) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(level=DiagnosticStatus.OK, name=name, message=message, values=pairs)


if __name__ == "__main__":
    sys.exit(main())
