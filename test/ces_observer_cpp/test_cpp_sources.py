"""What the C++ package is built from: parameters as in the table, reasons as in Python."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from ces_identify.export.cpp_sources import PYTHON_ONLY, list_parameters, parameter_library, reason_header
from ces_observer import damper_observer
from ces_observer.errors import CesError
from ces_observer.nodes.parameter_table import NAME, OF_A_DAMPER, OF_THE_NODE
from ces_observer.options import Option
from ces_observer.reasons import REASONS
from ces_observer.tick import tracker

ROOT = Path(__file__).resolve().parents[2]


def nested(options: dict[str, Any], name: str) -> Any:
    for key in name.split("."):
        options = options[key]
    return options


def declaration(option: Option) -> dict[str, Any]:
    found: dict[str, Any] = nested(yaml.safe_load(parameter_library("damper", [option]))["damper"], option.name)
    return found


def test_each_option_is_declared_with_type_default_and_meaning() -> None:
    (root, tree), *others = yaml.safe_load(parameter_library("damper", list_parameters())).items()
    assert root == "damper" and not others
    kinds = {"bool": bool, "int": int, "double": float, "string": str}
    for option in list_parameters():
        declared = nested(tree, option.name)
        assert kinds[declared["type"].removesuffix("_array")] is option.kind
        assert declared["type"].endswith("_array") == option.many
        assert declared.get("default_value") == option.default
        assert declared["description"] == option.described.replace('"', "'")


def test_it_has_the_parameters_of_the_python_node_but_a_few() -> None:
    names = {option.name.partition(".")[0] for option in list_parameters()}
    common = {option.name for option in (*OF_THE_NODE, *OF_A_DAMPER, NAME)}
    assert names == common - {*PYTHON_ONLY} | {"position", "current", "speed", "acceleration"}


@pytest.mark.parametrize(
    ("option", "validation"),
    [
        (Option("age", 0.5, "", 0, 3600), {"ces::within<>": [0.0, 3600.0]}),
        (Option("depth", 5, "", 1, 100), {"ces::within<>": [1, 100]}),
        (Option("name", "a", ""), None),
        (Option("numbers", [1, 2], ""), None),
    ],
)
def test_ranges_are_checked_by_validators_with_arguments_of_the_type(option: Option, validation: object) -> None:
    declared = declaration(option)
    assert repr(declared.get("validation")) == repr(validation)
    assert declared.get("additional_constraints", "") == (option.expected if option.name in ("age", "depth") else "")


def test_a_text_is_a_literal_in_cpp() -> None:
    """The library puts it between quotes as it is."""
    declared = declaration(Option("field", r'position[a"b\c]', 'the "field"'))
    assert declared["default_value"] == r"position[a\"b\\c]"
    assert declared["description"] == "the 'field'"
    with pytest.raises(CesError, match="printable"):
        parameter_library("damper", [Option("field", "a\nb", "")])


def test_reasons_have_the_codes_of_the_tick_and_the_words_of_python() -> None:
    header = reason_header()
    names = re.findall(r"\w+", re.findall(r"enum Reason : std::size_t \{(.*)\};", header)[0])
    texts = json.loads("[" + re.findall(r"REASON_TEXTS\{([^}]*)\};", header)[0] + "]")
    for name, text in zip(names, texts, strict=True):
        if name in vars(damper_observer) and name.isupper() and names.index(name) >= len(REASONS):
            assert text == getattr(damper_observer, name)
        else:
            assert text == REASONS[getattr(tracker, name)]


RUN = """
import runpy
import sys
sys.path.insert(0, {root!r})
sys.argv[1:] = [{folder!r}]
runpy.run_module("ces_identify.export.cpp_sources", run_name="__main__")
"""


def test_the_standard_library_suffices(tmp_path: Path) -> None:
    program = RUN.format(root=str(ROOT), folder=str(tmp_path))
    subprocess.run([sys.executable, "-I", "-S", "-c", program], check=True)
    written = {path.name for path in tmp_path.iterdir()}
    printed = {f"ces_{name}.{suffix}" for name in ("core", "arrivals") for suffix in "ch"}
    assert written == {*printed, "parameters.yaml", "from_python.hpp"}
