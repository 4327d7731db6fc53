"""How the nodes are run: one executor, one thread, an end in order, and a garbage collector that does not interrupt.

Every node program is `run(make, argv)` around a function that builds its node. Never a multi-threaded executor: the
callbacks of one node then need no locks, and a sample is never overtaken by the next one.
"""

from __future__ import annotations

import gc
import signal
from collections.abc import Callable, Sequence

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos_overriding_options import InvalidQosOverridesError

from ces_observer.errors import CesError
from ces_observer.nodes.parameter_table import EXECUTOR

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # an rclpy before 7.1, or one that gave it another place
    EventsExecutor = None

AUTO, EVENTS, SINGLE = EXECUTOR.one_of
USER_ERROR = 2
END_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# What a wrong parameter, name or QoS raises while a node is built; rcl's own errors are RuntimeErrors.
START_ERRORS = (CesError, ParameterException, NameValidationException, InvalidQosOverridesError, RuntimeError)


def run(name: str, make: Callable[[], Node], argv: Sequence[str] | None = None) -> int:
    """Build the node `name` with `make` and run it; returns the program's exit status.

    0 when a signal ended it, 2 with one FATAL line if what START_ERRORS lists was raised. The node says by its
    attribute `executor_choice`, a word of EXECUTOR, how it wants to be run; without it, `auto` holds.
    """
    ends: list[int] = []
    for number in END_SIGNALS:
        # rclpy shuts down on these by itself; Python's KeyboardInterrupt besides would strike in the middle of
        # anything, and a second SIGINT, as ros2 launch sends, would end the interpreter on its way out.
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
    return SingleThreadedExecutor() if choice == SINGLE or EventsExecutor is None else EventsExecutor()


def freeze_garbage() -> None:
    """Keep what was built so far out of the collector's sight and let it run by `collect_garbage` alone."""
    gc.collect()
    gc.freeze()
    gc.disable()


def collect_garbage() -> None:
    """Collect what became garbage in cycles since the last time: well under a millisecond, as all else is frozen."""
    gc.collect()


def _build(
    name: str, make: Callable[[], Node], argv: Sequence[str] | None, ends: Sequence[int]
) -> tuple[Node, Executor] | None:
    """Return node and executor; None if there is a mistake, which is told, or a signal came meanwhile."""
    try:
        rclpy.init(args=None if argv is None else list(argv))
        node = make()
        executor = make_executor(getattr(node, "executor_choice", AUTO))
    except START_ERRORS as error:
        if not ends:  # otherwise the signal has pulled the context away from under the node
            get_logger(name).fatal(str(error).splitlines()[0])
        return None
    return None if ends else (node, executor)


def _spin(node: Node, executor: Executor) -> None:
    executor.add_node(node)
    freeze_garbage()
    try:
        executor.spin()
    except ExternalShutdownException:
        pass
    except RuntimeError:
        if rclpy.ok():  # otherwise the signal came before a publish, which then found no context
            raise
    finally:
        executor.shutdown()
        node.destroy_node()
