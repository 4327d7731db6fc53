"""A ROS 2 node each of whose callbacks runs behind one `Guard`, rclpy's own included.

rclpy registers its services of parameters and its subscription to /clock by the same methods as the node its own
callbacks; those methods are guarded here. What an executor does before a callback must not raise either: rclpy would
leave a callback group blocked forever. So messages are taken as bytes and deserialised behind the guard, and each
callback has a group of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock

from ces_observer.nodes.guard import Guard, find_excess, find_too_many

SERVICE_DEPTH = 1000  # requests that wait; with the default of rclpy, 10, the others of a burst get no answer
FAILED = "unexpected error in the node; see its log"


class GuardedNode(Node):  # type: ignore[misc]  # rclpy is not there where types are checked
    """A node with a `guard`; `guard.wrap` is for callbacks that are not registered by a method of the node."""

    def __init__(self, name: str, **options: Any) -> None:
        logger = get_logger(name)
        self.guard = Guard(logger.error, (ExternalShutdownException,), lambda: not self.context.ok())
        self._warned: set[str] = set()
        super().__init__(name, **options)

    def start(self) -> None:
        """Begin what the node does; nothing, if its constructor already has."""

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[[Any], None], qos_profile: Any, **options: Any
    ) -> Subscription:
        """Do the same as rclpy, but guarded; a message that cannot be deserialised is ignored with one warning."""
        if not options.pop("raw", False):
            callback = partial(self._deserialise, msg_type, topic, callback)
        options.setdefault("callback_group", MutuallyExclusiveCallbackGroup())
        guarded = self.guard.wrap(callback)
        return super().create_subscription(msg_type, topic, guarded, qos_profile, raw=True, **options)

    def create_service(self, srv_type: Any, srv_name: str, callback: Callable[..., Any], **options: Any) -> Service:
        """Do the same as rclpy, but guarded: a service that fails says so, and refuses requests that are too large."""
        answer = _set_each if srv_type is SetParameters else _answer
        guarded = self.guard.wrap(partial(answer, callback), answer_failure=partial(_refuse, FAILED))
        options.setdefault("callback_group", MutuallyExclusiveCallbackGroup())
        options["qos_profile"] = QoSProfile(depth=SERVICE_DEPTH)
        return super().create_service(srv_type, srv_name, guarded, **options)

    def create_timer(self, timer_period_sec: float, callback: Callable[[], None], **options: Any) -> Timer:
        """Do the same as rclpy, but guarded."""
        options.setdefault("callback_group", MutuallyExclusiveCallbackGroup())
        return super().create_timer(timer_period_sec, self.guard.wrap(callback), **options)

    def add_on_set_parameters_callback(self, callback: Callable[..., SetParametersResult]) -> None:
        """Do the same as rclpy, but guarded: parameters whose check fails are refused."""
        refusal = SetParametersResult(successful=False, reason=FAILED)
        super().add_on_set_parameters_callback(self.guard.wrap(callback, answer_failure=lambda _: refusal))

    def add_post_set_parameters_callback(self, callback: Callable[..., None]) -> None:
        """Do the same as rclpy, but guarded."""
        super().add_post_set_parameters_callback(self.guard.wrap(callback))

    def _deserialise(self, msg_type: Any, topic: str, callback: Callable[[Any], None], raw: bytes) -> None:
        try:
            message = deserialize_message(raw, msg_type)
            if msg_type is Clock and message.clock.sec < 0:  # rclpy has no such times
                raise RuntimeError("its time is before 1970")
        except RuntimeError as error:
            if topic not in self._warned:
                self._warned.add(topic)
                self.get_logger().warning(f"{topic}: ignored messages that are no usable {msg_type.__name__}: {error}")
            return
        callback(message)


def _answer(callback: Callable[..., Any], request: Any, response: Any) -> Any:
    excess = find_excess(request)
    return _refuse(excess, request, response) if excess else callback(request, response)


def _set_each(callback: Callable[..., Any], request: Any, response: Any) -> Any:
    """Set the parameters one by one: rclpy's handler leaves those after a failure without a result."""
    if excess := find_too_many(request):
        return _refuse(excess, request, response)
    for parameter in request.parameters:
        one = _answer(callback, SetParameters.Request(parameters=[parameter]), SetParameters.Response())
        response.results.extend(one.results)
    return response


def _refuse(reason: str, request: Any, response: Any) -> Any:
    """Return the response with `reason`, as far as its type has a place for one."""
    result = SetParametersResult(successful=False, reason=reason)
    if hasattr(response, "results"):
        response.results = [result] * len(request.parameters)
    elif isinstance(getattr(response, "result", None), SetParametersResult):
        response.result = result
    elif hasattr(response, "message"):
        response.success, response.message = False, reason
    return response
