"""Values for parameters and the words with which a node refuses them, in Python and in C++ alike."""

from __future__ import annotations

from math import inf, nan

from ces_observer.nodes.parameter_table import IN_USE


def wrong_type(name: str, wanted: str, given: str) -> str:
    """Return what rclcpp says."""
    types = f"parameter {{{name}}} is of type {{{wanted}}}, setting it to {{{given}}}"
    return f"Wrong parameter type, {types} is not allowed."


def age(value: str) -> str:
    return f"parameter 'max_age_s' is {value}; expected a number from 0 to 3600"


def cannot(name: str, why: str) -> str:
    return f"parameter '{name}' cannot be set because it {why}"


# A parameter of the running observer, the type and the value that it is set to, and why not; empty: it is set.
CASES: tuple[tuple[str, str, object, str], ...] = (
    *(("max_age_s", "double", value, "") for value in (0.0, 3600.0, 5e-324, 0.5)),
    ("max_age_s", "double", -1.0, age("-1.0")),
    ("max_age_s", "double", -5e-324, age("-5e-324")),
    ("max_age_s", "double", 3600.0000000000005, age("3600.0000000000005")),
    ("max_age_s", "double", 1e308, age("1e+308")),
    ("max_age_s", "double", nan, age("nan")),
    ("max_age_s", "double", inf, age("inf")),
    ("max_age_s", "double", -inf, age("-inf")),
    (
        "wait_for_current_s",
        "double",
        12345.0,
        "parameter 'wait_for_current_s' is 12345.0; expected a number from 0 to 10",
    ),
    *(
        ("max_age_s", kind, value, wrong_type("max_age_s", "double", kind))
        for kind, value in (
            ("bool", True),
            ("integer", 1),
            ("string", "soon"),
            ("byte_array", [b"\x01"]),
            ("bool_array", [True]),
            ("integer_array", [1, 2]),
            ("double_array", [0.1, 0.2]),
            ("string_array", ["0.1"]),
        )
    ),
    ("max_age_s", "not set", None, "cannot undeclare a statically typed parameter"),
    ("max_age_s", "77", None, "parameter 'max_age_s' has a value of unknown type 77"),
    (
        "max_age_s",
        "string",
        "x" * 10_001,
        "parameter 'max_age_s' has 10001 characters or elements; expected at most 10000",
    ),
    *(
        (name, kind, value, f"parameter '{name}' cannot be set because {IN_USE}")
        for name, kind, value in (
            ("input_depth", "integer", 10),
            ("input_depth", "string", "many"),
            ("position.scale", "double", 2.0),
        )
    ),
    ("no_such", "double", 1.0, cannot("no_such", "was not declared")),
    ("no_such", "not set", None, cannot("no_such", "was not declared")),
    ("", "double", 1.0, cannot("", "was not declared")),
    ("", "77", None, "parameter '' has a value of unknown type 77"),
    ("x" * 1001, "double", 1.0, "a parameter's name of 1001 characters; expected at most 1000"),
    ("use_sim_time", "integer", 1, wrong_type("use_sim_time", "bool", "integer")),
)
# What a start with one wrong parameter says: the parameter, the type of the value, the value as -p takes it.
AT_START: dict[str, tuple[str, str, str]] = {
    wrong_type("max_age_s", "double", "integer"): ("max_age_s", "integer", "1"),
    wrong_type("max_age_s", "double", "string"): ("max_age_s", "string", "soon"),
    wrong_type("position.scale", "double", "integer"): ("position.scale", "integer", "-1"),
    wrong_type("input_depth", "integer", "double"): ("input_depth", "double", "1.5"),
    age("-1.0"): ("max_age_s", "double", "-1.0"),
    age("nan"): ("max_age_s", "double", ".nan"),
    "parameter 'input_depth' is 0; expected a whole number from 1 to 100000": ("input_depth", "integer", "0"),
    "parameter 'position.delay' is 2.0; expected a number from -1 to 1": ("position.delay", "double", "2.0"),
}
