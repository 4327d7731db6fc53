"""Runs the nodes: one executor, one thread, an orderly shutdown, and garbage collection at chosen times.

Every node program calls `run` with a function that builds its node. The executor has a single thread, so that callbacks
need no locks and samples stay in order. Each callback is guarded; if rclpy itself fails, its executor is spun again.
"""

from __future__ import annotations

import gc
import signal
from collections.abc import Callable, Sequence
from time import sleep

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.qos_overriding_options import InvalidQosOverridesError

from ces_observer.errors import CesError
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.parameter_table import EXECUTOR

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # rclpy before 7.1.4, or one that has moved it
    EventsExecutor = None

AUTO, EVENTS, SINGLE = EXECUTOR.one_of
USER_ERROR = 2
PAUSE_S = 0.001  # before rclpy's executor is spun again: a lasting error must not take the whole processor
END_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# Raised by a wrong parameter, name or QoS while a node is built; rcl's own errors are RuntimeErrors.
START_ERRORS = (CesError, ParameterException, NameValidationException, InvalidQosOverridesError, RuntimeError)


def run(name: str, make: Callable[[], GuardedNode], argv: Sequence[str] | None = None) -> int:
    """Build the node `name` with `make` and run it; returns the program's exit status.

    That is 0 after a signal, or 2 with one FATAL line after one of START_ERRORS. The node's attribute
    `executor_choice`, a value of EXECUTOR, selects the executor; the default is `auto`.
    """
    ends: list[int] = []
    for number in END_SIGNALS:
        # rclpy shuts down on these by itself. Python's KeyboardInterrupt could interrupt any statement, and a second
        # SIGINT, as ros2 launch sends, would kill the interpreter during shutdown.
        signal.signal(number, lambda number, frame: ends.append(number))
    try:
        built = _build(name, make, argv, ends)
        if built is None:
            return 0 if ends else USER_ERROR
        _spin(*built)
        return 0
    finally:
        rclpy.try_shutdown()
        for number in END_SIGNALS:
            signal.signal(number, signal.SIG_IGN)


def make_executor(choice: str) -> Executor:
    """Return a new executor for `choice`; raises CesError if it is unknown or this rclpy has no such executor."""
    EXECUTOR.check_value(choice)
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
            sleep(PAUSE_S)


def freeze_garbage() -> None:
    """Exclude all present objects from garbage collection, and leave the rest to `collect_garbage`."""
    gc.collect()
    gc.freeze()
    gc.disable()


def collect_garbage() -> None:
    """Collect new cyclic garbage: well under a millisecond, because all else is frozen."""
    gc.collect()


def _build(
    name: str, make: Callable[[], GuardedNode], argv: Sequence[str] | None, ends: Sequence[int]
) -> tuple[GuardedNode, Executor] | None:
    """Return node and executor; None after an error, which is logged, or a signal."""
    try:
        rclpy.init(args=None if argv is None else list(argv))
        node = make()
        executor = make_executor(getattr(node, "executor_choice", AUTO))
    except START_ERRORS as error:
        if not ends:  # otherwise the signal has shut down the context during the start
            get_logger(name).fatal(str(error).splitlines()[0])
        return None
    return None if ends else (node, executor)


def _spin(node: GuardedNode, executor: Executor) -> None:
    executor.add_node(node)
    freeze_garbage()
    try:
        spin_on(node, executor.spin)
    finally:
        executor.shutdown()
        node.destroy_node()
