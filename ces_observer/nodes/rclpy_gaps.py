"""What the nodes do because rclpy does not: each with the versions, or the issue of ros2/rclpy, that ask for it.

Tested are 7.1.1 and 7.1.11, the newest of Jazzy. What none of them asks for any more goes from here.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from functools import partial
from inspect import Parameter, Signature
from typing import Any

from lifecycle_msgs.msg import State
from rclpy.subscription import Subscription

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # rclpy before 7.1.4 or one that has moved it
    EventsExecutor = None

__all__ = [
    "MESSAGE_AND_INFO", "EventsExecutor", "Taken", "freeze_objects", "split_message", "take_waiting",
    "wrap_lifecycle_services",
]  # fmt: skip
Taken = tuple[bytes, dict[str, Any]]  # a message and rclpy's information about it
MESSAGE_AND_INFO = Signature([Parameter(name, Parameter.POSITIONAL_ONLY) for name in ("message", "info")])
LIFECYCLE_SERVICES = (
    "change_state", "get_state", "get_available_states", "get_available_transitions", "get_transition_graph",
)  # fmt: skip


def split_message(message: Any, info: Any) -> Any:
    """Return the arguments of a callback of MESSAGE_AND_INFO: EventsExecutors up to 7.1.11 pass one tuple."""
    return message if info is None else (message, info)


def take_waiting(subscription: Subscription, max_count: int) -> Iterator[Taken]:
    """Take the bytes of the messages that wait: a SingleThreadedExecutor takes one in each round."""
    handle = subscription.handle
    with handle:
        for _ in range(max_count):
            taken = handle.take_message(subscription.msg_type, True)
            if taken is None:
                return
            yield taken


def wrap_lifecycle_services(node: Any, wrap: Callable[[Callable[..., Any]], Callable[..., Any]]) -> None:
    """Wrap the callbacks of a node's lifecycle services, which no method of the node registers.

    A transition that the state does not have gets a plain answer, where rclpy raises (issue 1209). States are listed
    from the transitions: rclpy 7.1.1 reads beyond the end of its own list, and may crash.
    """

    def change_state(answer: Callable[..., Any], request: Any, response: Any) -> Any:
        try:
            return answer(request, response)
        except RuntimeError:  # by rcl
            wanted = request.transition.label or f"number {request.transition.id}"
            node.get_logger().error(f"transition {wanted} is not one of those from state '{node.state}'")
            return response

    def list_states(request: Any, response: Any) -> Any:
        ends = [end for _, _, *two in node._state_machine.transition_graph for end in (tuple(two[:2]), tuple(two[2:]))]
        states = sorted({(State.PRIMARY_STATE_UNKNOWN, "unknown"), *ends})
        response.available_states = [State(id=number, label=label) for number, label in states]
        return response

    for service in node.services:
        name = service.srv_name.rpartition("/")[2]
        if name == "change_state":
            service.callback = partial(change_state, service.callback)
        elif name == "get_available_states":
            service.callback = list_states
        if name in LIFECYCLE_SERVICES:
            service.callback = wrap(service.callback)


def freeze_objects() -> None:
    """Exempt the objects of now from the collection of garbage, which then takes well under a millisecond.

    The executors of rclpy leave cycles behind with each task, so that there is always some garbage.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()
