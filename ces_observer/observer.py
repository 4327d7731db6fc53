"""The observer node: piston position and valve current in, estimated damping force out on `~/estimate`.

It is driven by the position samples; its timer only watches for silence and publishes `/diagnostics`. What it cannot
stand for it withholds, saying why, and resumes by itself.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from math import inf
from time import monotonic

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos_overriding_options import InvalidQosOverridesError

from ces_observer.damper_topics import DamperTopics
from ces_observer.errors import CesError
from ces_observer.health import Health, Status
from ces_observer.observer_parameters import MAX_AGE, Settings, declare_settings
from ces_observer.tracker import OK

WATCH_S = 0.1  # period of the watch for silence, and least time between two diagnostics
DIAGNOSTICS_S = 1.0
USER_ERROR = 2
# What a wrong parameter, name or QoS raises while the node is built; rcl's own errors are RuntimeErrors.
START_ERRORS = (CesError, ParameterException, NameValidationException, InvalidQosOverridesError, RuntimeError)


class Observer(Node):  # type: ignore[misc]  # rclpy is not there where types are checked
    """The node `observer` with one damper; raises what START_ERRORS lists if it cannot be built."""

    def __init__(self) -> None:
        super().__init__("observer", automatically_declare_parameters_from_overrides=True)
        settings = declare_settings(self)
        self._topics = DamperTopics(self, settings, self._changed)
        self._health = Health(self._topics.damper, _facts(settings))
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._watched = self._rolled = self._told = monotonic()
        self._pending = False
        self._logged, self._logged_s = "", -inf
        self.add_post_set_parameters_callback(self._set)
        self.create_timer(WATCH_S, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _watch(self) -> None:
        now = monotonic()
        self._topics.watch(now - self._watched)
        self._watched = now
        if now - self._rolled >= DIAGNOSTICS_S:
            self._health.roll(now - self._rolled)
            self._rolled = now
            self._tell()
        elif self._pending:
            self._tell()

    def _changed(self) -> None:
        """Tell of a new reason at once, unless the last telling was just now: then the watch does."""
        self._pending = True
        if monotonic() - self._told >= WATCH_S:
            self._tell()

    def _tell(self) -> None:
        status = self._health.status(self._topics.detail())
        message = DiagnosticArray(status=[self._diagnostic(status)])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        self._told, self._pending = monotonic(), False
        self._log(status)

    def _diagnostic(self, status: Status) -> DiagnosticStatus:
        joint = self._topics.settings.name
        return DiagnosticStatus(
            level=bytes([status.level]),
            name=f"{self.get_fully_qualified_name()}: {joint}",
            message=status.message,
            hardware_id=joint,
            values=[KeyValue(key=key, value=value) for key, value in status.values],
        )

    def _log(self, status: Status) -> None:
        """Log a new reason, one line in DIAGNOSTICS_S at most, so that a flickering one does not flood the console."""
        reason = self._topics.damper.reason
        if reason == self._logged or self._told - self._logged_s < DIAGNOSTICS_S:
            return
        self._logged, self._logged_s = reason, self._told
        if reason == OK:
            self.get_logger().info(status.message)
        else:
            self.get_logger().warning(status.message)

    def _set(self, parameters: Sequence[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name == MAX_AGE:
                self._topics.damper.allow_age(parameter.value)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; returns 0 when stopped by a signal, 2 if a parameter or the model cannot be used."""
    # rclpy shuts down on SIGINT by itself; Python's KeyboardInterrupt besides would strike in the middle of anything,
    # and a second SIGINT, as ros2 launch sends, would end the interpreter on its way out.
    signal.signal(signal.SIGINT, lambda number, frame: None)
    try:
        return _run(argv)
    finally:
        rclpy.try_shutdown()
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run(argv: Sequence[str] | None) -> int:
    node = _started(argv)
    if node is None:
        return USER_ERROR
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        pass
    except RuntimeError:
        if rclpy.ok():  # otherwise the signal came before a publish, which then found no context
            raise
    return 0


def _started(argv: Sequence[str] | None) -> Observer | None:
    try:
        rclpy.init(args=None if argv is None else list(argv))
        return Observer()
    except START_ERRORS as error:
        get_logger("observer").fatal(str(error).splitlines()[0])
        return None


def _facts(settings: Settings) -> dict[str, str]:
    return {"model": str(settings.model_path), "model sha256": settings.model.digest()}


if __name__ == "__main__":
    sys.exit(main())
