"""Prints `ces_observer.tick` to C99 that reads like its source: `ces_core.h` and `ces_core.c`, for every model.

docs/tick.md says what the subset of Python is; what is outside it raises SubsetError with file and line. Functions are
named ces_NAME and constants CES_NAME. The header holds all constants and the entry points, which alone have external
linkage. Needs the standard library only, as setup.py and CMake run it before anything is installed:

    python3 -m ces_identify.export.c_printer FOLDER
"""

from __future__ import annotations

import ast
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from ces_identify.export.c_expressions import (
    ELEMENT,
    FLOAT,
    INT,
    MATH,
    NONE,
    PRIMARY,
    READ_ONLY,
    SMALL,
    SUM,
    TYPES,
    Expressions,
    Function,
    Module,
    Term,
)
from ces_identify.export.c_statements import FunctionPrinter
from ces_identify.export.c_text import Comments, block_comment, wrap
from ces_observer import tick

NUMBERS = {"inf": "INFINITY", "nan": "NAN", "pi": repr(math.pi)}
TICK = "ces_observer.tick"
MADE = "Printed from {}/ by ces_identify.export.c_printer; do not edit."
HEAD = """#ifndef CES_CORE_H
#define CES_CORE_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif
"""
FOOT = """
#ifdef __cplusplus
}
#endif

#endif"""
START = """#include "ces_core.h"

#include <float.h>
#include <stdlib.h>

#ifdef __FAST_MATH__
#error "compile without -ffast-math: the order of all operations matters"
#endif
#if DBL_MANT_DIG != 53
#error "double is not a number of 64 bits (IEEE 754)"
#endif
#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0
#error "intermediate results are not rounded to double: on x86, compile with -msse2 -mfpmath=sse"
#endif
#if defined(__clang__) || !defined(__GNUC__)
#pragma STDC FP_CONTRACT OFF
#endif /* GCC: -ffp-contract=off, which -std=c99 implies */"""


class Core:
    """The printed core: `header` and `source` are the lines of its two files, `functions` what they are made from."""

    def __init__(self, sources: Mapping[str, str], entry_points: Sequence[str], folder: str) -> None:
        self.folder, self.entry_points = folder, entry_points
        self.modules: dict[str, Module] = {}
        self.functions: dict[str, Function] = {}
        self.values: dict[str, int | float] = {}
        for name, source in sources.items():
            self._collect(name, ast.parse(source))
        for function in self.functions.values():
            self._check_calls(function, ())
        self.reached: set[str] = set()
        for name in entry_points:
            self._reach(self.functions[name])
        made = block_comment(MADE.format(folder))
        self.header, self.source = [*made, *HEAD.splitlines()], [*made, *START.splitlines()]
        for name, source in sources.items():
            self._print(self.modules[name], ast.parse(source), Comments(source))
        for name in entry_points:
            self._declare(self.functions[name])
        self.header += FOOT.splitlines()

    def _collect(self, name: str, tree: ast.Module) -> None:
        """Check a module's imports; note its constants, its functions, and what these call and store."""
        module = self.modules[name] = Module(f"{self.folder}/{name}.py")
        module.require(tree, ast.get_docstring(tree) is not None, "the module has no docstring")
        for node in tree.body[1:]:
            match node:
                case ast.ImportFrom(module=str() as source, names=names, level=0):
                    for alias in names:
                        self._import(module, node, source, alias)
                case ast.Assign(targets=[ast.Name(id=constant)], value=value):
                    self._constant(module, node, constant, Expressions(module).term(value), self._value(value))
                case ast.Assign(
                    targets=[ast.Tuple(elts=names)], value=ast.Call(func=ast.Name(id="range"), args=bounds)
                ):
                    self._range(module, node, [ast.unparse(name) for name in names], bounds)
                case ast.FunctionDef(decorator_list=[]):
                    self._function(module, node)
                case _:
                    raise module.error(node)
        for function in module.functions.values():
            if function.module is module:
                self._scan(module, function)

    def _value(self, node: ast.expr) -> Any:
        """Return the value of a checked expression of constants."""
        known = {"__builtins__": {}, "float": float, "int": int, "abs": abs, **vars(math), **self.values}
        return eval(compile(ast.Expression(node), self.folder, "eval"), known)

    def _range(self, module: Module, node: ast.AST, names: list[str], bounds: list[ast.expr]) -> None:
        terms = [Expressions(module).of_type(bound, INT) for bound in bounds]
        places = range(*(self._value(bound) for bound in bounds))
        what = f"{len(names)} names for a range of {len(places)}"
        module.require(node, len(terms) > 0 and len(places) == len(names) and abs(places.stop) < SMALL, what)
        for name, place in zip(names, places, strict=True):
            self._constant(module, node, name, Term("", INT), place)

    def _import(self, module: Module, node: ast.ImportFrom, source: str, alias: ast.alias) -> None:
        name, home = alias.name, self.modules.get(source.removeprefix(f"{TICK}."))
        module.require(node, not alias.asname and name not in module.names, f"{name} is imported twice, or renamed")
        if source == f"{TICK}.arrays" and name in ("Floats", "Ints"):
            return
        if source == "math" and name in NUMBERS:
            module.terms[name] = Term(NUMBERS[name], FLOAT)
        elif source == "math" and name in MATH:
            module.math.add(name)
        elif home and home is not module and source.startswith(TICK) and name in home.terms and name in self.values:
            module.terms[name] = home.terms[name]
        elif home and home is not module and source.startswith(TICK) and name in home.functions:
            module.functions[name] = home.functions[name]
        else:
            raise module.error(node, f"{name} of {source}: expected a name of math, or of a module before this one")

    def _constant(self, module: Module, node: ast.AST, name: str, term: Term, value: int | float) -> None:
        bare = name.lstrip("_")
        self._check_new(module, node, name, self.values)
        module.require(node, bare.upper() == bare, f"{name}: expected a name in capitals")
        module.require(node, term.type in (FLOAT, INT), f"{name}: expected a number")
        self.values[name] = value
        module.terms[name] = Term(f"CES_{bare}", term.type)

    def _check_new(self, module: Module, node: ast.AST, name: str, others: Iterable[str]) -> None:
        """Refuse a name that is already in the tick, in whichever module."""
        new = name not in module.names and all(name.lstrip("_") != other.lstrip("_") for other in others)
        where = [other.file for other in self.modules.values() if name in other.names][:1]
        module.require(node, new, f"{name}: expected a name that is nowhere else in the tick; see {', '.join(where)}")

    def _function(self, module: Module, node: ast.FunctionDef) -> None:
        arguments, name = node.args, node.name
        others = (arguments.vararg, arguments.kwarg, *arguments.kwonlyargs, *arguments.posonlyargs, *arguments.defaults)
        module.require(node, not any(others), f"{name}: expected plain arguments without default values")
        self._check_new(module, node, name, self.functions)
        kinds = {argument.arg: self._kind(argument.annotation) for argument in arguments.args}
        parameters, result = {argument: kind for argument, kind in kinds.items() if kind}, self._kind(node.returns)
        if len(parameters) < len(kinds) or NONE in parameters.values() or result is None or result in ELEMENT:
            raise module.error(
                node, f"{name}: expected arguments Floats, Ints, float, int or bool, and a number or None as result"
            )
        self.functions[name] = module.functions[name] = Function(name, node, module, parameters, result)

    def _kind(self, annotation: ast.expr | None) -> str | None:
        return {"None": NONE, **TYPES}.get(ast.unparse(annotation)) if annotation else None

    def _scan(self, module: Module, function: Function) -> None:
        """Note what a function calls, and the arrays that it stores into or passes on."""
        for part in ast.walk(function.node):
            match part:
                case ast.Assign(targets=[ast.Subscript(value=ast.Name(id=array))]):
                    function.stored.add(array)
                case ast.AugAssign(target=ast.Subscript(value=ast.Name(id=array))):
                    function.stored.add(array)
                case ast.Call(func=ast.Name(id=name), args=arguments) if name in module.functions:
                    called = module.functions[name]
                    function.calls.append(called)
                    names = [(place, item.id) for place, item in enumerate(arguments) if isinstance(item, ast.Name)]
                    function.passed += [(array, called, place) for place, array in names]

    def _check_calls(self, function: Function, callers: tuple[Function, ...]) -> None:
        """Refuse a function that calls itself, and one that has numbers of the model changed."""
        function.module.require(function.node, function not in callers, f"{function.name} calls itself")
        for called in function.calls:
            self._check_calls(called, (*callers, function))
        for name, kind in function.parameters.items():
            changed = kind in ELEMENT and name.rpartition("_")[2] in READ_ONLY and function.stores(name)
            what = f"{name} holds numbers of the model, which {function.name} or what it calls changes"
            function.module.require(function.node, not changed, what)

    def _reach(self, function: Function) -> None:
        self.reached.add(function.name)
        for called in function.calls:
            if called.name not in self.reached:
                self._reach(called)

    def _print(self, module: Module, tree: ast.Module, comments: Comments) -> None:
        own = [function for function in module.functions.values() if function.module is module]
        lines = block_comment(ast.get_docstring(tree) or "", module.file)
        begun = len(self.header)
        printed = []
        for node in tree.body[1:]:
            before = comments.before(node.lineno)
            if isinstance(node, ast.Assign):
                self.header += [*before, *self._places(module, node, comments)]
            elif isinstance(node, ast.FunctionDef):
                function = module.functions[node.name]
                linkage = "" if node.name in self.entry_points else "static "
                text = [*before, *FunctionPrinter(module, function, comments).text(linkage)]
                printed += ["", *text] if node.name in self.reached else []
        if len(self.header) > begun:
            self.header[begun:begun] = ["", *block_comment((ast.get_docstring(tree) or "").partition("\n")[0])]
        if printed:
            ahead = [function for function in own if self._called_ahead(function, own)]
            declared = [line for function in ahead for line in wrap(f"static {function.prototype};", 0)]
            self.source += ["", "", *lines, *declared, *printed]

    def _called_ahead(self, function: Function, own: list[Function]) -> bool:
        """Return whether a function without a declaration in the header is called above its definition."""
        above = own[: own.index(function)]
        hidden = function.name in self.reached and function.name not in self.entry_points
        return hidden and any(function in other.calls for other in above if other.name in self.reached)

    def _places(self, module: Module, node: ast.Assign, comments: Comments) -> list[str]:
        """Return the declaration of a constant, or of the places that a range counts."""
        target, last = node.targets[0], node.end_lineno or 0
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Call):
            names = [module.terms[ast.unparse(name)].text for name in target.elts]
            bounds = [Expressions(module).term(bound) for bound in node.value.args]
            if len(bounds) > 2:  # each is the one before it, and the step
                pairs = zip(names[1:], names, strict=False)
                names[1:] = [f"{name} = {before} + {bounds[2].within(SUM)}" for name, before in pairs]
            if len(bounds) > 1:
                names[0] += f" = {bounds[0].text}"
            listed = ", ".join(name.replace(" ", "\0") for name in names)
            return wrap(f"enum {{ {listed} }};{comments.beside(node.lineno, last)}", 0)
        name = ast.unparse(target)
        value, term, c_name = self.values[name], Expressions(module).term(node.value), module.terms[name].text
        said = comments.beside(node.lineno, last)
        if term.type == INT and abs(value) < SMALL:
            return wrap(f"enum {{ {c_name} = {term.text} }};{said}", 0)
        text = f"INT64_C({value})" if term.type == INT else term.text
        return [f"#define {c_name} {text if text.isidentifier() or term.rank == PRIMARY else f'({text})'}{said}"]

    def _declare(self, function: Function) -> None:
        """Declare an entry point in the header, with the beginning of its docstring."""
        docstring = (ast.get_docstring(function.node) or "").partition("\n\n")[0]
        self.header += ["", *block_comment(docstring), *wrap(f"{function.prototype};", 0)]


@cache
def read_core(entry_points: tuple[str, ...] = tick.ENTRY_POINTS) -> Core:
    """Return the core of `ces_observer.tick` with what the entry points need; raises SubsetError."""
    folder = Path(tick.__path__[0])
    sources = {name: (folder / f"{name}.py").read_text(encoding="utf-8") for name in tick.MODULES}
    return Core(sources, entry_points, "/".join(folder.parts[-2:]))


def print_core(sources: Mapping[str, str], entry_points: Sequence[str], folder: str = "tick") -> tuple[str, str]:
    """Return header and source of modules (name -> text, from the bottom up); raises SubsetError."""
    core = Core(sources, entry_points, folder)
    return _text(core.header), _text(core.source)


def core_texts(entry_points: tuple[str, ...] = tick.ENTRY_POINTS) -> dict[str, str]:
    """Return the texts of ces_core.c and ces_core.h."""
    core = read_core(entry_points)
    return {"ces_core.c": _text(core.source), "ces_core.h": _text(core.header)}


def _text(lines: Sequence[str]) -> str:
    return "\n".join(lines) + "\n"


def write_core(folder: Path) -> None:
    """Write both files into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in core_texts().items():
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_core(Path(sys.argv[1]))
