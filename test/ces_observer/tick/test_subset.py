"""The tick is in its subset of Python, and whatever is outside is refused, by file and line."""

from __future__ import annotations

import pytest

from ces_identify.export.c_expressions import SubsetError
from ces_identify.export.c_printer import Core, read_core

BEFORE = '''"""A module below."""

SIZE = 3


def other(s: Floats, x: float) -> float:
    """Store into s."""
    s[0] = x
    return x
'''
HEAD = '"""A module."""\n\nfrom math import exp, floor, inf\n\nfrom ces_observer.tick.below import SIZE, other\n'
ARRAYS = "p: Floats, n: Ints, s: Floats, k: Ints"


def source_of(text: str) -> str:
    """Return the C of a module with this text, all of whose functions are entry points."""
    names = [line.split()[1].partition("(")[0] for line in text.splitlines() if line.startswith("def ")]
    return Core({"below": BEFORE, "above": text}, names).source


def source_of_body(body: str, result: str = "float") -> str:
    lines = "".join(f"    {line}\n" for line in body.splitlines())
    return source_of(f"{HEAD}\ndef f({ARRAYS}, x: float, i: int, b: bool) -> {result}:\n{lines}")


def test_the_tick_is_in_the_subset() -> None:
    assert "double ces_structure_tick(" in read_core().source


BODIES = {
    "a statement": ("assert b\nreturn x", "`assert b` is not in the subset"),
    "an expression": ("y = lambda: x\nreturn x", "`lambda: x` is not in the subset"),
    "a local of two types": ("y = 0\ny = 1.0\nreturn y", "y has type int, and type float here"),
    "numbers of two types": ("return x + 1", "float and int are mixed"),
    "an int where a float is expected": ("return exp(i)", "exp(int) is not in the subset"),
    "a float as an index": ("return p[x]", "has type float; expected int"),
    "a division of ints": ("return float(i / 2)", "Div takes float only"),
    "a remainder of floats": ("return x % 2.0", "Mod takes int only"),
    "another result": ("return i", "the result has type int; expected float"),
    "an element of the wrong type": ("k[0] = x\nreturn x", "int and float are mixed"),
    "a number of the model that changes": ("p[0] = x\nreturn x", "p holds numbers of the model"),
    "a number of the model that a call changes": ("return other(p, x)", "p holds numbers of the model"),
    "a part of the model that a call changes": ("return other(part(p, i), x)", "p holds numbers of the model"),
    "a part by another name": ("q = part(s, i)\nreturn x", "only numbers are assigned"),
    "a local without a value": ("if b:\n    y = 1.0\nreturn y", "y may have no value here"),
    "a local of a loop that may not run": ("for j in range(i):\n    y = x\nreturn y", "y may have no value here"),
    "a counter after its loop": ("for j in range(i):\n    pass\nreturn float(j)", "j may have no value here"),
    "a counter that changes": ("for j in range(i):\n    j = 2\nreturn x", "j counts a loop"),
    "a counter named like a local": (
        "j = 0\nfor j in range(i):\n    pass\nreturn x",
        "j counts a loop, and is named outside",
    ),
    "a range without a fixed step": ("for j in range(0, 9, i):\n    pass\nreturn x", "a range has a literal step"),
    "a name of another function": ("return float(y)", "y is no local"),
    "an array by another name": ("q = s\nreturn x", "only numbers are assigned"),
    "an array that is chosen": ("return other(s if b else p, x)", "Floats: expected a number"),
    "a power": ("return x**2.0", "Pow is not in the subset"),
    "min": ("return min(x, 1.0)", "min(float, float) is not in the subset"),
    "an argument by name": ("return other(s, x=x)", "is not in the subset"),
    "a loop over an array": ("for y in p:\n    pass\nreturn x", "`for y in p:` is not in the subset"),
    "a number beyond 64 bits": ("return float(9223372036854775808)", "is not in the subset"),
    "a function of a constant": ("return exp(2.0)", "exp of a constant"),
    "too few arguments": ("return other(s)", "other takes Floats, float"),
    "a store beside a read": ("return s[0] + other(s, x)", "assign the result of the call to a local"),
    "two stores": ("return other(s, x) - other(s, 1.0)", "assign the result of the call to a local"),
    "a call within a chain": ("return x if 0.0 < other(s, x) < x else x", "in the middle of a chain"),
}


@pytest.mark.parametrize("name", BODIES)
def test_a_function_cannot_hold(name: str) -> None:
    body, message = BODIES[name]
    with pytest.raises(SubsetError, match=r"^tick/above\.py:\d+: ") as refused:
        source_of_body(body)
    assert message in str(refused.value)


def test_the_line_is_that_of_the_source() -> None:
    with pytest.raises(SubsetError, match=r"^tick/above\.py:9: "):
        source_of_body("y = x\nreturn y + 1")


FUNCTION = "def {}(x: float) -> float:\n    return x\n\n"
MODULES = {
    "no docstring": ("X = 1\n", "the module has no docstring"),
    "another package": ('"""A."""\nimport numpy\n', "`import numpy` is not in the subset"),
    "a module above": ('"""A."""\nfrom ces_observer.tick.top import X\n', "or of a module before this one"),
    "another name for an import": (
        '"""A."""\nfrom ces_observer.tick.below import SIZE as S\n', "or of a module before this one, not renamed"
    ),
    "a constant of the same name": ('"""A."""\nSIZE = 4\n', "SIZE: expected a name that is nowhere else in the tick"),
    "a function of the same name": (f'"""A."""\n{FUNCTION.format("other")}', "; see tick/below.py"),
    "a function of nearly the same name": (f'"""A."""\n{FUNCTION.format("_other")}', "nowhere else in the tick"),
    "a class": ('"""A."""\nclass C:\n    pass\n', "`class C:` is not in the subset"),
    "a decorator": (f'"""A."""\n@cache\n{FUNCTION.format("f")}', "is not in the subset"),
    "no annotation": ('"""A."""\ndef f(x) -> float:\n    return x\n', "f: expected arguments Floats, Ints, float"),
    "functions that call each other": (
        '"""A."""\ndef f(x: float) -> float:\n    return g(x)\n\ndef g(x: float) -> float:\n    return f(x)\n',
        "g calls itself",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MODULES)
def test_a_module_cannot_hold(name: str) -> None:
    text, message = MODULES[name]
    with pytest.raises(SubsetError, match=r"^tick/above\.py:\d+: ") as refused:
        source_of(text)
    assert message in str(refused.value)
