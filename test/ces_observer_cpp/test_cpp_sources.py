"""The table of parameters as YAML: each option is declared and set in it as in the table."""

from __future__ import annotations

from math import inf
from typing import Any

import pytest
import yaml

from ces_identify.export.parameter_library import parameter_file, parameter_library
from ces_observer.errors import CesError
from ces_observer.nodes.parameter_table import NAME, OF_A_DAMPER, OF_THE_NODE, signal_options
from ces_observer.options import Option
from ces_observer.signals import DEFAULTS

OPTIONS = (*OF_THE_NODE, *OF_A_DAMPER, NAME, *signal_options("current", DEFAULTS["current"] | {"scale": 2.0}))


def nested(options: dict[str, Any], name: str) -> Any:
    for key in name.split("."):
        options = options[key]
    return options


def declaration(option: Option) -> dict[str, Any]:
    found: dict[str, Any] = nested(yaml.safe_load(parameter_library("damper", [option]))["damper"], option.name)
    return found


def test_each_option_is_declared_with_type_default_and_meaning() -> None:
    (root, tree), *others = yaml.safe_load(parameter_library("damper", OPTIONS)).items()
    assert root == "damper" and not others
    kinds = {"bool": bool, "int": int, "double": float, "string": str}
    for option in OPTIONS:
        declared = nested(tree, option.name)
        assert kinds[declared["type"].removesuffix("_array")] is option.kind
        assert declared["type"].endswith("_array") == option.many
        assert declared.get("default_value") == option.default
        assert declared["read_only"] != option.live
        assert declared["description"] == option.described.replace('"', "'")


@pytest.mark.parametrize(
    ("option", "validation"),
    [
        (Option("age", 0.5, "", 0, 3600), {"ces::within<>": [0.0, 3600.0]}),
        (Option("gain", 1.0, ""), {"ces::within<>": [-inf, inf]}),
        (Option("depth", 5, "", 1, 100), {"ces::within<>": [1, 100]}),
        (Option("what", "a", "", choices=("a", "b")), {"ces::one_of<>": [["a", "b"]]}),
        (Option("name", "a", ""), None),
        (Option("numbers", [1, 2], ""), None),
    ],
)
def test_ranges_are_checked_by_validators_with_arguments_of_the_type(option: Option, validation: object) -> None:
    declared = declaration(option)
    assert repr(declared.get("validation")) == repr(validation)
    assert declared.get("additional_constraints", "") == (
        option.expected if option.name in ("age", "depth", "what") else ""
    )


def test_a_text_is_a_literal_in_cpp() -> None:
    """The library puts it between quotes as it is."""
    declared = declaration(Option("field", r'position[a"b\c]', 'the "field"'))
    assert declared["default_value"] == r"position[a\"b\\c]"
    assert declared["description"] == "the 'field'"
    with pytest.raises(CesError, match="printable"):
        parameter_library("damper", [Option("field", "a\nb", "")])


def test_the_file_sets_the_defaults_and_tells_the_meaning_once() -> None:
    options = [option for option in OPTIONS if option.default is not None]
    text = parameter_file("Parameters of a damper.", options)
    parameters = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert {option.name: nested(parameters, option.name) for option in options} == {o.name: o.default for o in options}
    assert text.startswith("# Parameters of a damper.\n/**:\n")
    assert max(map(len, text.splitlines())) <= 120
    words = " ".join(line.strip().removeprefix("# ") for line in text.splitlines() if line.strip().startswith("#"))
    for option in options:
        assert words.count(option.described.removeprefix("current: ")) == 1, option.name
    assert "[s]; 0: any; from 0 to 3600 (live)" in words
