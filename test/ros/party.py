"""What stands around a node under test: a node of its own, in a context of its own, spun by a thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Self

import rclpy
from parameter_cases import CASES
from patience import PATIENCE_S, wait_until
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from ces_observer.nodes.rclpy_gaps import EventsExecutor


class Party:
    """A node `name` in a namespace; it hears what it has subscribed to within `with`, and is gone after it.

    Its executor is the quickest, so that it keeps up with nodes at 1 kHz on a busy computer; callbacks of one argument.
    """

    def __init__(self, name: str, namespace: str) -> None:
        self._context = rclpy.Context()
        self._context.init()
        self.namespace = namespace
        self.node = rclpy.create_node(name, namespace=namespace, context=self._context)
        self._executor = (EventsExecutor or SingleThreadedExecutor)(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._executor.shutdown(PATIENCE_S)
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive(), f"the executor of {self.node.get_name()} does not end"
        self.node.destroy_node()
        self._context.shutdown()

    def set_parameters(self, name: str, values: Mapping[str, object]) -> SetParametersResult:
        """Set parameters of the node `name` in this namespace together; return its answer."""
        changed = [Parameter(one, value=value) for one, value in values.items()]
        answer = self._parameters_of(name).set_parameters_atomically(changed)
        wait_until(answer.done, f"no answer to {values}")
        return answer.result().result

    def get_parameter(self, name: str, parameter: str) -> object:
        """Return the value of a parameter of the node `name` in this namespace."""
        answer = self._parameters_of(name).get_parameters([parameter])
        wait_until(answer.done, f"no answer about {parameter}")
        return parameter_value_to_python(answer.result().values[0])

    def _parameters_of(self, name: str) -> AsyncParameterClient:
        client = AsyncParameterClient(self.node, f"{self.namespace}/{name}")
        assert client.wait_for_services(PATIENCE_S)
        return client

    @contextmanager
    def repeating(self, period_s: float, act: Callable[[], None]) -> Iterator[None]:
        """Call `act` again and again, beside what is done in this context."""
        timer = self.node.create_timer(period_s, act)
        try:
            yield
        finally:
            self.node.destroy_timer(timer)


# ----------------------------------- What a running node answers to the cases of `parameter_cases`, by both services.


def as_message(name: str, kind: str, value: object) -> ParameterMessage:
    """Return a parameter of a type that need not exist."""
    number = int(kind) if kind.isdigit() else getattr(ParameterType, f"PARAMETER_{kind.replace(' ', '_').upper()}")
    fields = {} if value is None else {f"{kind}_value": value}
    return ParameterMessage(name=name, value=ParameterValue(type=number, **fields))


def require_answers(party: Party, name: str) -> None:
    """Fail unless the node `name` answers each case as it must, together with the others and alone."""
    parameters, expected = [as_message(*case[:3]) for case in CASES], [case[3] for case in CASES]
    service = party.node.create_client(SetParameters, f"{name}/set_parameters")
    alone = party.node.create_client(SetParametersAtomically, f"{name}/set_parameters_atomically")
    assert service.wait_for_service(PATIENCE_S) and alone.wait_for_service(PATIENCE_S)
    answer = service.call_async(SetParameters.Request(parameters=parameters))
    wait_until(answer.done, f"no answer of {name}")
    assert _words(answer.result().results) == expected
    results = []
    for one in parameters:  # one by one: the client's queue of answers is short
        answer = alone.call_async(SetParametersAtomically.Request(parameters=[one]))
        wait_until(answer.done, f"no answer of {name} to one parameter alone")
        results.append(answer.result().result)
    assert _words(results) == expected


def _words(results: list[SetParametersResult]) -> list[str]:
    assert all(result.successful != bool(result.reason) for result in results)
    return [result.reason for result in results]
