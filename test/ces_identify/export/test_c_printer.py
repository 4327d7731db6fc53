"""The printed C: it compiles without a warning, holds what the source says, and computes the same."""

from __future__ import annotations

import ast
import random
import re
import subprocess
import sys
from ctypes import CDLL, c_double, c_int64
from importlib import import_module
from pathlib import Path

import pytest
from compiled_core import WARNINGS
from needs import skip_without

from ces_identify.export.c_printer import Core, read_core, write_core
from ces_observer import tick

SOURCES = [Path(tick.__path__[0]) / f"{name}.py" for name in tick.MODULES]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("core")
    write_core(path)
    return path


@pytest.mark.needs("cc")
def test_it_compiles_without_a_warning(folder):
    words = ["cc", "-std=c99", "-O2", *WARNINGS, "-c", "ces_core.c", "-o", "core.o"]
    subprocess.run(words, cwd=folder, check=True)


@pytest.mark.needs("c++")
def test_the_header_serves_cpp(folder):
    (folder / "use.cpp").write_text('#include "ces_core.h"\nint main() { return CES_KIND; }\n')
    subprocess.run(["c++", "-std=c++17", *WARNINGS, "-c", "use.cpp", "-o", "use.o"], cwd=folder, check=True)


@pytest.mark.needs("cc")
@pytest.mark.parametrize("flag", ["-ffast-math", "-mfpmath=387"])
def test_it_refuses_to_be_rounded_otherwise(folder, flag):
    words = ["cc", "-std=c99", flag, "-c", "ces_core.c", "-o", "core.o"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if "unrecognized" in done.stderr:
        pytest.skip(f"this compiler has no {flag}")
    assert done.returncode
    assert "#error" in done.stderr


@pytest.mark.needs("cc")
def test_constants_have_their_values(folder):
    """All places of arrays, too: the C counts them by itself."""
    values = {}
    for path in SOURCES:
        module = import_module(f"{tick.__name__}.{path.stem}")
        targets = [node.targets[0] for node in ast.parse(path.read_text()).body if isinstance(node, ast.Assign)]
        names = [part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)]
        values.update({name: getattr(module, name) for name in names})
    lines = [f'    if (!(CES_{name.lstrip("_")} == {value!r})) puts("{name}");' for name, value in values.items()]
    text = "\n".join(['#include <stdio.h>\n#include "ces_core.h"\nint main(void) {', *lines, "    return 0;\n}\n"])
    (folder / "constants.c").write_text(text)
    subprocess.run(["cc", "-std=c99", "constants.c", "-o", "constants"], cwd=folder, check=True)
    assert not subprocess.run([folder / "constants"], capture_output=True, text=True, check=True).stdout
    assert len(values) > 300


def words_of(text):
    return " ".join(word for word in text.split() if word not in ("*", "//", "/*", "*/", "#"))


def test_comments_and_docstrings_are_printed():
    text = words_of(read_core().header + read_core().source)
    for path in SOURCES:
        source = path.read_text(encoding="utf-8")
        said = [ast.get_docstring(ast.parse(source)) or "", *re.findall(r"# (.*)", source)]
        missing = [words for words in map(words_of, said) if words not in text]
        assert all(words.startswith(("fmt:", "noqa")) for words in missing), (path, missing)


def test_the_printer_needs_the_standard_library_only(tmp_path):
    """It runs in setup.py and under CMake, before anything is installed."""
    root = Path(tick.__path__[0]).parent.parent
    words = [sys.executable, "-I", "-S", "-c", f"import sys; sys.path.insert(0, {str(root)!r}); "
             f"from ces_identify.export.c_printer import write_extension; from pathlib import Path; "
             f"write_extension(Path({str(tmp_path)!r}))"]  # fmt: skip
    subprocess.run(words, check=True)
    assert (tmp_path / "ces_core.c").read_text() == read_core().source


def compile_core(folder, sources, entry_points):
    """Return the printed C of modules, compiled without a warning."""
    skip_without("cc")
    core = Core(sources, entry_points)
    (folder / "ces_core.h").write_text(core.header)
    (folder / "ces_core.c").write_text(core.source)
    words = ["cc", "-std=c99", "-O2", "-ffp-contract=off", *WARNINGS, "-shared", "-fPIC", "ces_core.c", "-o", "made.so"]
    subprocess.run(words, cwd=folder, check=True)
    return CDLL(str(folder / "made.so"))


OPERATORS = ("+", "-", "*", "/")


def expression(rng, depth):
    """Return a random expression of floats x, y, z."""
    if depth == 0:
        return rng.choice(("x", "y", "z", "0.1", "3.0"))
    a, b = expression(rng, depth - 1), expression(rng, depth - 1)
    form = rng.randrange(7)
    if form < 4:
        return f"({a}) {OPERATORS[form]} ({b})" if form < 3 else f"({a}) / (1.5 + abs({b}))"
    if form == 4:
        return f"-({a})"
    test = f"({a}) < ({b}) <= 2.0 and not y > ({a}) or x == ({b})"
    return f"(({a}) if {test} else ({b}))" if form == 5 else f"({a}) - float(int(({b}) / 1.0e3) // 3 % 2)"


def test_the_order_of_operations_is_that_of_the_source(tmp_path):
    rng = random.Random(38)
    bodies = [expression(rng, 3) for _ in range(150)]
    functions = "\n\n".join(
        f"def f{i}(x: float, y: float, z: float) -> float:\n    return {ast.unparse(ast.parse(body))}"
        for i, body in enumerate(bodies)
    )
    text = f'"""Functions."""\n\n{functions}\n'
    library, names = compile_core(tmp_path, {"made": text}, [f"f{i}" for i in range(len(bodies))]), {}
    exec(compile(text, "made", "exec"), names)
    for i in range(len(bodies)):
        compiled = library[f"ces_f{i}"]
        compiled.restype, compiled.argtypes = c_double, [c_double] * 3
        for _ in range(20):
            numbers = [rng.uniform(0.0, 3.0) for _ in range(3)]
            assert compiled(*numbers) == names[f"f{i}"](*numbers), bodies[i]


LOOPS = '''"""Loops."""

from ces_observer.tick.arrays import Floats, Ints


def count(k: Ints, end: int) -> int:
    """Count, in all ways."""
    total = 0
    for i in range(end):
        if i == 7:
            continue
        for j in range(i, k[0]):  # whose end is that at the beginning
            k[0] += 1
            total = total * 3 % 1000003 + j
        k[0] = 9
        doubled = 2 * i
        total += doubled
    for i in range(end, 0, -2):
        total = total * 5 % 1000003 + i
        if total % 11 == 3:
            break
    m = 0
    while m < end:
        if total % 2 == 0:
            step = 1
        elif total % 3 == 0:
            break
        else:
            step = 2
        m += step
        total += m
    return total
'''


def test_loops_do_as_those_of_python(tmp_path):
    compiled, names = compile_core(tmp_path, {"loops": LOOPS}, ["count"]).ces_count, {}
    exec(compile(LOOPS, "loops", "exec"), names)
    compiled.restype, compiled.argtypes = c_int64, [c_int64 * 1, c_int64]
    for end in range(-2, 25):
        assert compiled((c_int64 * 1)(9), end) == names["count"]([9], end), end
