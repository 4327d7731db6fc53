"""Limits of requests to the services of parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from ces_observer.nodes.parameter_requests import MAX_NAME_LENGTH, MAX_NAMES, MAX_VALUE_LENGTH, VALUES, find_excess


@dataclass
class Value:
    """The arrays of rcl_interfaces/msg/ParameterValue."""

    string_value: str = ""
    byte_array_value: list[bytes] = field(default_factory=list)
    bool_array_value: list[bool] = field(default_factory=list)
    integer_array_value: list[int] = field(default_factory=list)
    double_array_value: list[float] = field(default_factory=list)
    string_array_value: list[str] = field(default_factory=list)


def test_usual_requests_pass() -> None:
    assert find_excess(SimpleNamespace()) == ""  # as of std_srvs/Trigger
    assert find_excess(SimpleNamespace(names=["model"] * MAX_NAMES)) == ""
    assert find_excess(SimpleNamespace(prefixes=["a" * MAX_NAME_LENGTH], depth=2)) == ""
    value = Value("m" * MAX_VALUE_LENGTH, double_array_value=[0.0] * MAX_VALUE_LENGTH, string_array_value=["a"])
    assert find_excess(SimpleNamespace(parameters=[SimpleNamespace(name="model", value=value)])) == ""


@pytest.mark.parametrize("name", ["names", "prefixes", "parameters"])
def test_too_many(name: str) -> None:
    request = SimpleNamespace(**{name: ["a"] * (MAX_NAMES + 1)})
    assert find_excess(request) == f"501 {name} in one request; expected at most 500"


def test_too_long_a_name() -> None:
    assert "name of 1001 characters" in find_excess(SimpleNamespace(names=["a", "b" * 1001]))
    parameter = SimpleNamespace(name="b" * 1001, value=Value())
    assert "name of 1001 characters" in find_excess(SimpleNamespace(parameters=[parameter]))


@pytest.mark.parametrize("kind", VALUES)
def test_too_long_a_value(kind: str) -> None:
    value = Value(**{kind: "a" * (MAX_VALUE_LENGTH + 1) if kind == "string_value" else [0] * (MAX_VALUE_LENGTH + 1)})
    request = SimpleNamespace(parameters=[SimpleNamespace(name="model", value=value)])
    assert find_excess(request) == "parameter 'model' has 10001 characters or elements; expected at most 10000"


def test_too_long_a_string_in_an_array() -> None:
    value = Value(string_array_value=["a", "b" * (MAX_VALUE_LENGTH + 1)])
    request = SimpleNamespace(parameters=[SimpleNamespace(name="dampers", value=value)])
    assert "parameter 'dampers' has a string of more than" in find_excess(request)
