"""Calls every service, parameter and topic of nodes with valid, invalid, huge, concurrent and repeated input.

Each attack is a method; `attack_all` runs them one after the other and yields the name of each that is over.
"""

from __future__ import annotations

import random
import time
from collections.abc import Iterator, Sequence
from itertools import batched
from math import inf, nan
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from party import Party
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from type_description_interfaces.srv import GetTypeDescription

RELIABLE = QoSProfile(depth=100)  # best effort ones too hear it
ANSWER_S = 120.0
AT_ONCE = 8  # the queues of services hold ten
MILLION = 1_000_000
VALUES: tuple[tuple[str, int, Any], ...] = (
    ("double_value", ParameterType.PARAMETER_DOUBLE, nan),
    ("double_value", ParameterType.PARAMETER_DOUBLE, inf),
    ("double_value", ParameterType.PARAMETER_DOUBLE, -inf),
    ("double_value", ParameterType.PARAMETER_DOUBLE, 1e308),
    ("double_value", ParameterType.PARAMETER_DOUBLE, -5e-324),
    ("integer_value", ParameterType.PARAMETER_INTEGER, 2**63 - 1),
    ("integer_value", ParameterType.PARAMETER_INTEGER, -(2**63)),
    ("bool_value", ParameterType.PARAMETER_BOOL, False),
    ("string_value", ParameterType.PARAMETER_STRING, ""),
    ("string_value", ParameterType.PARAMETER_STRING, "/nowhere/\u00e4\U0001f600\n"),
    ("string_value", ParameterType.PARAMETER_STRING, "x" * 9_000),
    ("byte_array_value", ParameterType.PARAMETER_BYTE_ARRAY, [b"\x00", b"\xff"]),
    ("bool_array_value", ParameterType.PARAMETER_BOOL_ARRAY, [True]),
    ("integer_array_value", ParameterType.PARAMETER_INTEGER_ARRAY, [2**63 - 1, -1]),
    ("double_array_value", ParameterType.PARAMETER_DOUBLE_ARRAY, [nan, inf, 0.0]),
    ("double_array_value", ParameterType.PARAMETER_DOUBLE_ARRAY, []),
    ("string_array_value", ParameterType.PARAMETER_STRING_ARRAY, ["", "\ufffd"]),
    ("bool_value", ParameterType.PARAMETER_NOT_SET, False),
    ("bool_value", 99, False),  # no such type
)
HUGE_VALUES: tuple[tuple[str, int, Any], ...] = (
    ("string_value", ParameterType.PARAMETER_STRING, "x" * MILLION),
    ("double_array_value", ParameterType.PARAMETER_DOUBLE_ARRAY, [1.0] * MILLION),
    ("byte_array_value", ParameterType.PARAMETER_BYTE_ARRAY, [b"x"] * MILLION),
)
NAMES: tuple[list[str], ...] = (
    [],
    [""],
    ["no_such"],
    ["a" * MILLION],
    ["a"] * 100_000,
    ["model", "no_such", "model"],
    ["\n\u00e4\U0001f600..."] * 10,
    ["."] * 500,
)


class Misuser(Party):
    """Misuses the nodes of these names in its namespace, which must be there, with its part of the attacks."""

    def __init__(self, namespace: str, nodes: Sequence[str], part: slice = slice(None)) -> None:
        super().__init__("misuser", namespace)
        self.nodes, self.part = nodes, part
        self._random = random.Random(1)
        self.values: dict[str, dict[str, ParameterValue]] = {}
        self.unexpected: dict[str, str] = {}
        self._clients: dict[tuple[str, str], Any] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear_diagnostics, 1000)

    def meets_nodes(self) -> None:
        """Wait until all nodes are there, and read their parameters."""
        for name in self.nodes:
            self._read_parameters(name)

    def attack_all(self) -> Iterator[str]:
        """Run all attacks."""
        for name in self.nodes:
            yield from self._attack_services(name)
        self._attack_inputs()
        yield "inputs"
        self._attack_clock()
        yield "clock"
        for name in self.nodes:
            self.restore(name)
        yield "parameters set back"

    def call(self, name: str, kind: Any, service: str, *requests: Any) -> list[Any]:
        """Call a service of a node with several requests at a time; return the answers, all of which must come."""
        key = name, service
        if key not in self._clients:
            self._clients[key] = self.node.create_client(kind, f"{name}/{service}")
        assert self._clients[key].wait_for_service(ANSWER_S), f"{name}/{service} is gone"
        answers: list[Any] = []
        for some in batched(requests, AT_ONCE):
            futures, end = [self._clients[key].call_async(request) for request in some], time.monotonic() + ANSWER_S
            while not all(future.done() for future in futures):
                assert time.monotonic() < end, f"an answer of {name}/{service} is missing"
                time.sleep(0.001)
            answers += [future.result() for future in futures]
        return answers

    def restore(self, name: str) -> None:
        """Set the parameters that have changed back to their first values."""
        names = list(self.values[name])
        present = self._get(name, names)
        changed = [one for one in names if str(present[one]) != str(self.values[name][one])]
        parameters = [Parameter(name=one, value=self.values[name][one]) for one in changed]
        results = self.call(name, SetParameters, "set_parameters", SetParameters.Request(parameters=parameters))
        refused = [f"{one}: {result.reason}" for one, result in zip(changed, results[0].results, strict=True)]
        assert all(result.successful for result in results[0].results), refused

    def _read_parameters(self, name: str) -> None:
        request = ListParameters.Request(depth=ListParameters.Request.DEPTH_RECURSIVE)
        names = self.call(name, ListParameters, "list_parameters", request)[0].result.names
        self.values[name] = self._get(name, names)
        assert len(self.values[name]) > 5

    def _get(self, name: str, names: Sequence[str]) -> dict[str, ParameterValue]:
        requests = [GetParameters.Request(names=[one]) for one in names]
        answers = self.call(name, GetParameters, "get_parameters", *requests)
        return {one: answer.values[0] for one, answer in zip(names, answers, strict=True) if answer.values}

    def _attack_services(self, name: str) -> Iterator[str]:
        for field, kind, value in (*VALUES, *HUGE_VALUES)[self.part]:
            self._set_all(name, ParameterValue(**{"type": kind, field: value}), len(str(value)) < MILLION)
        yield f"{name}: parameters"
        for names in NAMES[self.part]:
            for kind, service in (
                (GetParameters, "get_parameters"),
                (DescribeParameters, "describe_parameters"),
                (GetParameterTypes, "get_parameter_types"),
            ):
                self.call(name, kind, service, *[kind.Request(names=names)] * 2)
            for depth in (0, 1, 2**64 - 1):
                request = ListParameters.Request(prefixes=names, depth=depth)
                self.call(name, ListParameters, "list_parameters", request)
        yield f"{name}: names of parameters"
        for kind in ("std_msgs/msg/String", "", "x" * MILLION, "no/such/Type"):
            request = GetTypeDescription.Request(type_name=kind, type_hash="RIHS01_" + "0" * 64)
            self.call(name, GetTypeDescription, "get_type_description", request)
        if name in ("observer", "controller"):
            answers = self.call(name, Trigger, "reload_model", *[Trigger.Request()] * 50)
            assert all(answer.success and "request" in answer.message for answer in answers)
        yield f"{name}: other services"

    def _set_all(self, name: str, value: ParameterValue, is_small: bool) -> None:
        """Set all parameters to a value in one request, one after the other and again, and all together."""
        parameters = [Parameter(name=one, value=value) for one in (*self.values[name], "no_such", "")]
        chosen = parameters if is_small else parameters[:1]
        request = SetParameters.Request(parameters=chosen)
        for answer in self.call(name, SetParameters, "set_parameters", request, request):
            assert len(answer.results) == len(chosen)
        together = SetParametersAtomically.Request(parameters=chosen)
        assert not self.call(name, SetParametersAtomically, "set_parameters_atomically", together)[0].result.successful

    def _attack_inputs(self) -> None:
        """Publish what is no sample on the topics of samples: garbage, other joints, arrays of all lengths."""
        joints = [
            JointState(),
            JointState(name=["other"], position=[1.0]),
            JointState(name=["rear_damper"]),
            JointState(name=["x"] * 1000, position=[nan] * 999),
            JointState(name=["x" * MILLION], position=[inf] * MILLION),
        ]
        for topic, kind, messages in (
            ("joint_states", JointState, joints),
            ("stamped_current", Temperature, []),
            ("measured_force", WrenchStamped, [WrenchStamped()]),
            ("valve_command", Float64, [Float64(data=value) for value in (nan, inf, -inf, 1e308, -1e308)]),
        ):
            self._publish(kind, topic, messages, RELIABLE)

    def _attack_clock(self) -> None:
        """Let the observer follow /clock while there are times before 1970, at the end of time, and garbage."""
        on = Parameter(name="use_sim_time", value=ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True))
        assert self._set_one("observer", on)
        clocks = [Clock(), Clock(), Clock(), Clock()]
        clocks[1].clock.sec, clocks[2].clock.sec, clocks[3].clock.nanosec = -(2**31), 2**31 - 1, 2**32 - 1
        self._publish(Clock, "clock", 20 * clocks, RELIABLE)
        on.value.bool_value = False
        assert self._set_one("observer", on)

    def _set_one(self, name: str, parameter: Parameter) -> bool:
        request = SetParameters.Request(parameters=[parameter])
        return bool(self.call(name, SetParameters, "set_parameters", request)[0].results[0].successful)

    def _publish(self, kind: type, topic: str, messages: Sequence[Any], qos: QoSProfile) -> None:
        """Publish the messages and as much garbage, three times, from three publishers."""
        publishers = [self.node.create_publisher(kind, topic, qos) for _ in range(3)]
        end = time.monotonic() + ANSWER_S
        while not all(publisher.get_subscription_count() for publisher in publishers):
            assert time.monotonic() < end, f"nobody subscribes to {topic}"
            time.sleep(0.01)
        for publisher in publishers:
            for message in (*messages, *(self._make_garbage(size) for size in (4, 5, 12, 40, 1000, MILLION))):
                publisher.publish(message)
                time.sleep(0.002)
        time.sleep(0.2)
        for publisher in publishers:
            self.node.destroy_publisher(publisher)

    def _make_garbage(self, size: int) -> bytes:
        """Return random bytes behind the header of little-endian CDR."""
        return b"\x00\x01\x00\x00" + self._random.randbytes(size - 4)

    def _hear_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for pair in status.values:
                if pair.key == "unexpected errors" and not pair.value.startswith("0,"):
                    self.unexpected[status.name] = pair.value
