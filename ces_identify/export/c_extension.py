"""Prints the C of `ces_observer._tick`, the compiled core for CPython, for setup.py; needs the standard library only.

tick_module.c, beside this file, holds what is the same for every function; a wrapper for each entry point is printed.
An entry point whose arrays do not all come first has none.
"""

from __future__ import annotations

from pathlib import Path

from ces_identify.export.c_expressions import BOOL, ELEMENT, FLOAT, INT, NONE, Function
from ces_identify.export.c_printer import Core, read_core, write_core
from ces_observer.core import tick_digest

# What the compiled core needs besides: a compiler's own exp or pow, for arguments that it knows, rounds otherwise.
C_FLAGS = ("-ffp-contract=off", *(f"-fno-builtin-{name}" for name in ("exp", "log", "sin", "cos", "tanh", "pow")))

TAKE = {FLOAT: "PyFloat_AsDouble({})", INT: "as_int({})", BOOL: "PyObject_IsTrue({}) == 1"}
GIVE = {FLOAT: "return PyFloat_FromDouble({});", INT: "return PyLong_FromLongLong({});",
        BOOL: "return PyBool_FromLong({});", NONE: "{};\n    Py_RETURN_NONE;"}  # fmt: skip
CALL = """\
static PyObject *call_{name}(PyObject *self, PyObject *const *given, Py_ssize_t count) {{
    const Py_buffer *arrays = ((Bound *)self)->arrays;
    if (count != {count}) {{
        return refuse_count("{name}", {count}, count);
    }}
{numbers}
    if (PyErr_Occurred()) {{
        return NULL;
    }}
    {result}
}}

"""
ENTRY = '    {{"{kinds}", {{"{name}", (PyCFunction)(void (*)(void))call_{name}, METH_FASTCALL, NULL}}}},\n'


def print_calls(core: Core, digest: str) -> str:
    """Return the text of tick_calls.h: a wrapper for each entry point, and their table."""
    wrappers, entries = "", ""
    for function in (core.functions[name] for name in core.entry_points):
        kinds = [kind in ELEMENT for kind in function.parameters.values()]
        if kinds == sorted(kinds, reverse=True):
            wrappers += _wrapper(function, sum(kinds))
            entries += ENTRY.format(kinds=_array_kinds(function), name=function.node.name)
    table = f"static Entry ENTRIES[] = {{\n{entries}    {{NULL, {{NULL, NULL, 0, NULL}}}},\n}};\n"
    return f'#define TICK_DIGEST "{digest}"\n\n{wrappers}{table}'


def _wrapper(function: Function, arrays: int) -> str:
    kinds = list(function.parameters.values())[arrays:]
    numbers = [f"    const {kind} x{i} = {TAKE[kind].format(f'given[{i}]')};" for i, kind in enumerate(kinds)]
    arguments = [*(f"arrays[{i}].buf" for i in range(arrays)), *(f"x{i}" for i in range(len(kinds)))]
    result = GIVE[function.result].format(f"{function.c_name}({', '.join(arguments)})")
    unused = [f"    (void){name};" for name, used in (("arrays", arrays), ("given", kinds)) if not used]
    return CALL.format(name=function.node.name, count=len(kinds), numbers="\n".join(unused + numbers), result=result)


def _array_kinds(function: Function) -> str:
    letters = {
        name: "d" if ELEMENT[kind] == FLOAT else "q" for name, kind in function.parameters.items() if kind in ELEMENT
    }
    return "".join(letter.upper() if name in function.stored else letter for name, letter in letters.items())


def write_extension(folder: Path) -> list[str]:
    """Write the C of the extension into a folder; return the paths of what is to be compiled."""
    write_core(folder)
    (folder / "tick_calls.h").write_text(print_calls(read_core(), tick_digest()), encoding="utf-8")
    module = folder / "tick_module.c"
    module.write_text(Path(__file__).with_name("tick_module.c").read_text(encoding="utf-8"), encoding="utf-8")
    return [str(folder / "ces_core.c"), str(module)]
