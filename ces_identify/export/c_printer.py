"""Prints `ces_observer.tick` to C99 that reads like its source: the core for every model, and the module for CPython.

docs/tick.md says what the subset of Python is; what is outside it raises SubsetError with file and line. Functions are
named ces_NAME and constants CES_NAME. `ces_core.h` holds all constants and the entry points, which alone have external
linkage. Around `ces_core.c`, setup.py compiles `ces_observer._tick`: tick_module.c, beside this file, holds what is the
same for every function; a wrapper is printed for each entry point whose arrays all come first. Needs the standard
library only, as setup.py and CMake run it before anything is installed:

    python3 -m ces_identify.export.c_printer FOLDER
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path

from ces_identify.export.c_expressions import (
    BOOL,
    ELEMENT,
    FLOAT,
    INT,
    NONE,
    OF_MATH,
    PRIMARY,
    SUM,
    CTerm,
    Expressions,
    Function,
    Module,
)
from ces_identify.export.c_statements import Comments, FunctionPrinter, block_comment, wrap
from ces_observer import tick
from ces_observer.core import tick_digest

TICK = "ces_observer.tick"
READ_ONLY = ("p", "n")  # the last part of the names of arrays that hold numbers of a model
TEMPLATES = Path(__file__).with_name("templates")


class Core:
    """The printed core: the texts of its `header` and its `source`, and the `functions` they are made from.

    Takes the texts of modules by name, from the bottom up, and their folder as errors name it.
    """

    def __init__(self, sources: Mapping[str, str], entry_points: Sequence[str], folder: str = "tick") -> None:
        self.folder, self.entry_points = folder, entry_points
        self.modules: dict[str, Module] = {}
        self.functions: dict[str, Function] = {}
        self.defined: dict[str, str] = {}  # names in C, and the files that define them
        header = [line for name, text in sources.items() for line in self._read_module(name, text)]
        entries = [self.functions[name] for name in entry_points]
        self.used = [*entries]
        for function in self.used:  # which grows by what these call
            self.used += dict.fromkeys(called for called, _ in function.calls if called not in self.used)
        source = [line for module in self.modules.values() for line in self._definitions(module)]
        for function in entries:
            docstring = (ast.get_docstring(function.node) or "").partition("\n\n")[0]
            header += ["", *block_comment(docstring), *wrap(f"{function.prototype};")]
        self.header, self.source = self._fill("ces_core.h", header), self._fill("ces_core.c", source)

    def _fill(self, file: str, lines: list[str]) -> str:
        text = (TEMPLATES / f"{file}.j2").read_text(encoding="utf-8")
        text = text.replace("{{ folder }}", self.folder).replace("{{ digest }}", tick_digest())
        return text.replace("{{ printed }}", "\n".join(lines))

    def _read_module(self, name: str, source: str) -> list[str]:
        """Note a module with the C of its functions; return the lines of C that declare its constants."""
        tree, comments, constants = ast.parse(source), Comments(source), []
        module = Module(f"{self.folder}/{name}.py", ast.get_docstring(tree) or "")
        module.require(tree, bool(module.docstring), "the module has no docstring")
        for node in tree.body:
            if isinstance(node, ast.FunctionDef):
                function = self.functions[node.name] = module.make_function(node)
                self._define(module, node, node.name, function.c_name, function)
        for node in tree.body[1:]:
            match node:
                case ast.ImportFrom(module=str() as home):
                    self._import(module, node, home)
                case ast.Assign():
                    constants += comments.above(node.lineno)
                    text = self._constant(module, node)
                    constants += wrap(text, 0, " ".join(comments.take(node.end_lineno or 0)))
                case ast.FunctionDef(decorator_list=[]):
                    above, function = comments.above(node.lineno), self.functions[node.name]
                    linkage = "" if node.name in self.entry_points else "static "
                    function.lines = [*above, *FunctionPrinter(function, comments).text(linkage)]
                case _:
                    raise module.error(node)
        self.modules[name] = module
        return ["", *block_comment(module.docstring.partition("\n")[0]), *constants] if constants else []

    def _define(self, module: Module, node: ast.AST, name: str, c_name: str, item: CTerm | Function) -> None:
        """Note a constant or function; refuse a name that is already in the tick, in whichever module."""
        what = f"{name}: expected a name that is nowhere else in the tick; see {self.defined.get(c_name)}"
        module.require(node, c_name not in self.defined, what)
        self.defined[c_name] = module.file
        module.names[name] = item

    def _import(self, module: Module, node: ast.ImportFrom, source: str) -> None:
        home = self.modules.get(source.removeprefix(f"{TICK}."))
        names: Mapping[str, CTerm | Function] = OF_MATH if source == "math" else home.names if home else {}
        is_seen, what = names or source == f"{TICK}.arrays", "expected a name of math, or of a module before this one"
        for alias in node.names:
            module.require(node, bool(is_seen) and not alias.asname, f"{alias.name} of {source}: {what}, not renamed")
            if alias.name in names:
                module.names[alias.name] = names[alias.name]

    def _constant(self, module: Module, node: ast.Assign) -> str:
        """Note a constant, or the places that a range counts; return its declaration."""
        expressions = Expressions(module, {})
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Call(func=ast.Name(id="range"), args=bounds)):
                terms = [expressions.of_type(bound, INT) for bound in bounds]
                places = [f"CES_{ast.unparse(name).lstrip('_')}" for name in names]
                for name, place in zip(names, places, strict=True):
                    self._define(module, node, ast.unparse(name), place, CTerm(place, INT))
                first = f"{places[0]} = {terms[0].text}" if len(terms) > 1 else places[0]
                step = f" + {terms[2].within(SUM)}" if len(terms) > 2 else ""
                later = [f"{place} = {before}{step}" if step else place for before, place in pairwise(places)]
                return f"enum {{ {', '.join([first, *later])} }};"
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                term, place = expressions.term(value), f"CES_{name.lstrip('_')}"
                self._define(module, node, name, place, CTerm(place, term.type))
                is_small = term.type == INT and "INT64_C" not in term.text
                written = f"enum {{ {place} = {term.text} }};" if is_small else ""
                return written or f"#define {place} {term.within(PRIMARY - 1)}"
        raise module.error(node)

    def _definitions(self, module: Module) -> list[str]:
        """Return the functions of a module that are used, after declarations of those called above their definition."""
        functions = [function for function in self.functions.values() if function.module is module]
        functions = [function for function in functions if function in self.used]
        declared: list[str] = []
        called: set[Function] = set()
        for function in functions:
            for name in function.stored:
                what = f"{name} holds numbers of the model, which {function.node.name} or what it calls changes"
                module.require(function.node, name.rpartition("_")[2] not in READ_ONLY, what)
            if function in called and function.node.name not in self.entry_points:
                declared += wrap(f"static {function.prototype};")
            called |= {other for other, _ in function.calls}
        head = ["", "", *block_comment(module.docstring, module.file), *declared] if functions else []
        return [*head, *(line for function in functions for line in ("", *function.lines))]


@cache
def read_core(entry_points: tuple[str, ...] = tick.ENTRY_POINTS) -> Core:
    """Return the core of `ces_observer.tick` with what the entry points need; raises SubsetError."""
    folder = Path(tick.__path__[0])
    sources = {name: (folder / f"{name}.py").read_text(encoding="utf-8") for name in tick.MODULES}
    return Core(sources, entry_points, "/".join(folder.parts[-2:]))


def write_core(folder: Path) -> None:
    """Write both files of the core of `ces_observer.tick` into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "ces_core.h").write_text(read_core().header, encoding="utf-8")
    (folder / "ces_core.c").write_text(read_core().source, encoding="utf-8")


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


if __name__ == "__main__":
    write_core(Path(sys.argv[1]))
