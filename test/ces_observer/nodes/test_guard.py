"""The guard: no exception leaves a callback, all are counted, each kind is logged once."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from time import thread_time
from timeit import repeat
from types import SimpleNamespace

import pytest

from ces_observer.limits import NodeLimits
from ces_observer.nodes.guard import MAX_KINDS, MAX_LENGTH, VALUES, Guard, find_excess


def fail(error: BaseException) -> None:
    raise error


def recurse() -> None:
    recurse()


def exhaust_memory() -> None:
    bytes(sys.maxsize)


FAILURES: list[Callable[[], None]] = [
    lambda: fail(ValueError("wrong")),
    lambda: fail(KeyError("no key")),
    lambda: fail(OSError(28, "No space left on device")),
    lambda: fail(AssertionError()),
    lambda: fail(UnicodeEncodeError("utf-8", "\ud800", 0, 1, "surrogates not allowed")),
    lambda: print(1 // 0),
    recurse,
    exhaust_memory,
]


@pytest.mark.parametrize("failure", FAILURES)
def test_no_exception_leaves_a_callback(failure: Callable[[], None]) -> None:
    logged: list[str] = []
    guard = Guard(logged.append)
    for _ in range(3):
        assert guard.wrap(failure)() is None
    guard.call(failure)
    assert guard.count == 4
    assert len(logged) == 1 and "Traceback" in logged[0] and len(logged[0].splitlines()) < 100
    assert dict(guard.values())["unexpected errors"].startswith("4, the last: ")


def test_what_has_failed_is_put_right_and_answered() -> None:
    done: list[str] = []
    guard = Guard(done.append)
    guarded = guard.wrap(lambda a: 1 // a, lambda: done.append("right again"), lambda a: f"{a} failed")
    assert (guarded(1), guarded(0)) == (1, "0 failed")
    assert done[1:] == ["right again"]
    assert guard.wrap(lambda: fail(ValueError()), lambda: fail(KeyError()))() is None
    assert guard.count == 3


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(2), LookupError()])
def test_what_shall_end_the_program_passes(error: BaseException) -> None:
    guard = Guard(print, passing=(LookupError,))
    with pytest.raises(type(error)):
        guard.wrap(fail)(error)
    with pytest.raises(type(error)):
        guard.call(lambda: fail(error))
    assert guard.count == 0


def test_nothing_is_a_failure_once_the_node_ends() -> None:
    logged: list[str] = []
    guard = Guard(logged.append, is_ending=lambda: True)
    guard.wrap(fail)(RuntimeError("publisher's context is invalid"))
    assert (guard.count, logged) == (0, [])


def test_a_log_that_fails_harms_nothing() -> None:
    guard = Guard(lambda text: fail(OSError("log is full")))
    guard.wrap(fail)(ValueError())
    assert guard.count == 1


def test_memory_of_kinds_and_texts_is_bounded() -> None:
    logged: list[str] = []
    guard = Guard(logged.append)
    for number in range(2 * MAX_KINDS):
        guard.wrap(fail)(type(f"Error{number}", (Exception,), {})("x" * 10_000))
    assert guard.count == 2 * MAX_KINDS
    assert len(logged) == MAX_KINDS
    assert len(guard.last) == MAX_LENGTH


def test_a_remark_is_made_once() -> None:
    guard = Guard(lambda text: None)
    assert guard.take_remark() == ""
    guard.wrap(fail)(ValueError("wrong"))
    assert guard.take_remark() == "1 unexpected errors, the last: ValueError: wrong"
    assert guard.take_remark() == ""


def test_a_coroutine_is_refused_when_it_is_registered() -> None:
    async def answer() -> None: ...

    with pytest.raises(TypeError, match="coroutine"):
        Guard(print).wrap(answer)


def test_it_costs_a_microsecond_at_most() -> None:
    """At 1 kHz that is a thousandth of one core; measured is less than a tenth of it."""

    def callback(message: bytes) -> None: ...

    guarded, message = Guard(print).wrap(callback), b""
    cost_s = min(repeat(lambda: guarded(message), number=10_000, repeat=5, timer=thread_time)) / 10_000
    assert cost_s < 1e-6


@dataclass
class Value:
    """The arrays of rcl_interfaces/msg/ParameterValue."""

    string_value: str = ""
    type: int = 4
    byte_array_value: list[bytes] = field(default_factory=list)
    bool_array_value: list[bool] = field(default_factory=list)
    integer_array_value: list[int] = field(default_factory=list)
    double_array_value: list[float] = field(default_factory=list)
    string_array_value: list[str] = field(default_factory=list)


def test_usual_requests_pass() -> None:
    assert find_excess(SimpleNamespace()) == ""  # as of std_srvs/Trigger
    assert find_excess(SimpleNamespace(names=["model"] * NodeLimits.MAX_NAMES)) == ""
    assert find_excess(SimpleNamespace(prefixes=["a" * NodeLimits.MAX_NAME_LENGTH], depth=2)) == ""
    value = Value(
        "m" * NodeLimits.MAX_VALUE_LENGTH,
        double_array_value=[0.0] * NodeLimits.MAX_VALUE_LENGTH,
        string_array_value=["a"],
    )
    assert find_excess(SimpleNamespace(parameters=[SimpleNamespace(name="model", value=value)])) == ""


@pytest.mark.parametrize("name", ["names", "prefixes", "parameters"])
def test_too_many(name: str) -> None:
    request = SimpleNamespace(**{name: ["a"] * (NodeLimits.MAX_NAMES + 1)})
    assert find_excess(request) == f"501 {name} in one request; expected at most 500"


def test_too_long_a_name() -> None:
    assert "name of 1001 characters" in find_excess(SimpleNamespace(names=["a", "b" * 1001]))
    parameter = SimpleNamespace(name="b" * 1001, value=Value())
    assert "name of 1001 characters" in find_excess(SimpleNamespace(parameters=[parameter]))


@pytest.mark.parametrize("kind", VALUES)
def test_too_long_a_value(kind: str) -> None:
    value = Value(
        **{
            kind: "a" * (NodeLimits.MAX_VALUE_LENGTH + 1)
            if kind == "string_value"
            else [0] * (NodeLimits.MAX_VALUE_LENGTH + 1)
        }
    )
    request = SimpleNamespace(parameters=[SimpleNamespace(name="model", value=value)])
    assert find_excess(request) == "parameter 'model' has 10001 characters or elements; expected at most 10000"


def test_an_unknown_type() -> None:
    request = SimpleNamespace(parameters=[SimpleNamespace(name="model", value=Value(type=77))])
    assert find_excess(request) == "parameter 'model' has a value of unknown type 77"


def test_too_long_a_string_in_an_array() -> None:
    value = Value(string_array_value=["a", "b" * (NodeLimits.MAX_VALUE_LENGTH + 1)])
    request = SimpleNamespace(parameters=[SimpleNamespace(name="dampers", value=value)])
    assert "parameter 'dampers' has a string of more than" in find_excess(request)
