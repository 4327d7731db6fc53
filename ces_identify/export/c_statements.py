"""Statements of the tick's subset of Python, checked and as C, with their comments, in the scopes that C needs.

A local is declared in the innermost block around all that name it: at its first assignment if that stands there, else
above the statement that holds it. No declaration needs a value, as nothing is read that may have none.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

from ces_identify.export.c_expressions import (
    BOOL,
    ELEMENT,
    FLOAT,
    INT,
    NONE,
    ORDER,
    READS,
    SIGNS,
    WORDS,
    Expressions,
    Function,
    Module,
    Term,
    c_local,
)
from ces_identify.export.c_text import INDENT, Comments, block_comment, wrap

Block = list[ast.stmt]
Path = tuple[int, ...]  # the blocks around a place, from the outermost one


def _is_elif(node: ast.If) -> bool:
    return len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If) and node.orelse[0].col_offset == node.col_offset


def _blocks(node: ast.stmt) -> list[Block]:
    """Return the blocks inside a statement."""
    return [block for block in (getattr(node, "body", []), getattr(node, "orelse", [])) if block]


def _names(node: ast.stmt) -> Iterator[str]:
    """Give the names in a statement, less those in its blocks."""
    for part in ast.iter_child_nodes(node):
        if not isinstance(part, ast.stmt):
            yield from (inner.id for inner in ast.walk(part) if isinstance(inner, ast.Name))


class FunctionPrinter(Expressions):
    """Prints one function."""

    def __init__(self, module: Module, function: Function, comments: Comments) -> None:
        super().__init__(module, function)
        self.definition, self.comments = function, comments
        self.lines: list[str] = []
        self.homes: dict[str, Path] = {}  # of each local: the blocks around all that name it
        self.declared = set(self.locals)
        self.waiting: list[tuple[int, int, list[str]]] = []  # a line in C, its depth, locals to be declared there
        self.counters: list[str] = []  # of the loops around this place

    def text(self, linkage: str) -> list[str]:
        """Return the definition, with docstring and comments."""
        node = self.definition.node
        docstring = ast.get_docstring(node) or ""
        body = node.body[1:] if docstring else node.body
        parts = [part for statement in body for part in ast.walk(statement)]
        used = {part.id for part in parts if isinstance(part, ast.Name)}
        stored = {part.id for part in parts if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)}
        self._find_homes(body, (), stored)
        self.lines = [f"{INDENT}(void){c_local(name)};" for name in self.locals if name not in used]
        self._block(body, (), 1, (node.end_lineno or 0) + 1)
        if self.assigned is not None and self.definition.result != NONE:
            raise self.error(node, f"{self.definition.name} may end without a result")
        for line, depth, names in reversed(self.waiting):
            self.lines[line:line] = [f"{INDENT * depth}{self.locals[name]} {c_local(name)};" for name in names]
        head = wrap(f"{linkage}{self.definition.prototype} {{", 0)
        return [*block_comment(docstring), *head, *self.lines, "}"]

    def _find_homes(self, block: Block, path: Path, names: set[str]) -> None:
        """Note for each local the blocks around all that name it."""
        for node in block:
            counted = {node.target.id} if isinstance(node, ast.For) and isinstance(node.target, ast.Name) else set()
            for name in names.intersection(_names(node)) - counted:
                pairs = zip(path, self.homes.get(name, path), strict=False)
                self.homes[name] = tuple(ours for ours, theirs in pairs if ours == theirs)
            for inner in _blocks(node):
                chain = isinstance(node, ast.If) and inner is node.orelse and _is_elif(node)
                self._find_homes(inner, path if chain else (*path, id(inner)), names - counted)

    def _put(self, depth: int, text: str, first: int, last: int) -> None:
        """Write a line, with what the source says beside these lines of it."""
        self.lines += wrap(text + self.comments.beside(first, last), depth)

    def _put_comments(self, depth: int, line: int, column: int = 0) -> None:
        self.lines += [INDENT * depth + comment for comment in self.comments.before(line, column)]

    def _block(self, block: Block, path: Path, depth: int, end: int) -> None:
        """Print the statements of a block that lies above line `end` of the source."""
        for node, next_line in zip(block, [*(node.lineno for node in block[1:]), end], strict=True):
            if self.assigned is None:
                raise self.error(node, "this is never reached")
            self._put_comments(depth, node.lineno)
            self._declare_above(node, path, depth)
            self._statement(node, path, depth, next_line)
        self._put_comments(depth, end, block[-1].col_offset)

    def _declare_above(self, node: ast.stmt, path: Path, depth: int) -> None:
        """Leave a place for declarations of locals at home here that the statement does not declare itself."""
        inside = {name.id for name in ast.walk(node) if isinstance(name, ast.Name)}
        names = [name for name, home in self.homes.items() if home == path and name in inside - self.declared]
        match node:
            case ast.Assign(targets=[ast.Name(id=name)]) if name in names:
                names.remove(name)
        if names:
            self.waiting.append((len(self.lines), depth, names))
            self.declared.update(names)

    def _statement(self, node: ast.stmt, path: Path, depth: int, end: int) -> None:
        last = node.end_lineno or node.lineno
        match node:
            case ast.Assign(targets=[target], value=value):
                self._put(depth, self._assignment(node, target, self.term(value)), node.lineno, last)
            case ast.AugAssign(target=target, op=operator, value=value):
                self._put(depth, self._change(node, target, operator, self.term(value)), node.lineno, last)
            case ast.Expr(value=ast.Call() as call):
                term = self.term(call)
                self._put(depth, f"{'' if term.type == NONE else '(void)'}{term.text};", node.lineno, last)
            case ast.Return(value=value):
                term = self.term(value) if value else Term("", NONE)
                what = f"the result has type {WORDS[term.type]}; expected {WORDS[self.definition.result]}"
                self.require(node, term.type == self.definition.result, what)
                self._put(depth, f"return {term.text};" if value else "return;", node.lineno, last)
                self.assigned = None
            case ast.Break() | ast.Continue():
                self._put(depth, "break;" if isinstance(node, ast.Break) else "continue;", node.lineno, last)
                self.assigned = None
            case ast.Pass():
                self._put(depth, ";", node.lineno, last)
            case ast.If():
                self._if(node, "if", path, depth, end)
            case ast.While(test=test, orelse=[]):
                endless = isinstance(test, ast.Constant) and not any(isinstance(x, ast.Break) for x in ast.walk(node))
                self._loop(node, f"while ({self.condition(test).text}) {{", path, depth, end)
                self.assigned = None if endless else self.assigned
            case ast.For(target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="range"), args=bounds), orelse=[]):
                self._for(node, name, bounds, path, depth, end)
            case _:
                raise self.error(node)

    def _assignment(self, node: ast.stmt, target: ast.expr, value: Term) -> str:
        if isinstance(target, ast.Subscript):
            return f"{self._element(node, target, value).text} = {value.text};"
        if not isinstance(target, ast.Name) or value.type not in (FLOAT, INT, BOOL):
            raise self.error(node, "only numbers are assigned, to one name or element")
        name, declaration = target.id, ""
        self._check_name(node, name)
        if name not in self.declared:
            self.declared.add(name)
            declaration = f"{value.type} "
        if self.locals.setdefault(name, value.type) != value.type:
            raise self.error(node, f"{name} has type {WORDS[self.locals[name]]}, and type {WORDS[value.type]} here")
        if self.assigned is not None:
            self.assigned.add(name)
        return f"{declaration}{c_local(name)} = {value.text};"

    def _change(self, node: ast.stmt, target: ast.expr, operator: ast.operator, value: Term) -> str:
        if isinstance(target, ast.Subscript):
            element = self._element(node, target, value)._replace(effect=READS)
        elif isinstance(target, ast.Name):
            self._check_name(node, target.id)
            element = self.term(target)
        else:
            raise self.error(node, "only a name or an element is changed")
        self.arithmetic(node, element, operator, value)
        return f"{element.text} {SIGNS[type(operator)][0]}= {value.text};"

    def _element(self, node: ast.stmt, target: ast.Subscript, value: Term) -> Term:
        """Return an element that a value is stored into."""
        element = self.term(target)
        self.same_type(node, element, value)
        index = self.term(target.slice)
        self.effect(node, index, value)
        if isinstance(target.value, ast.Name) and target.value.id.rpartition("_")[2] in ("p", "n"):
            raise self.error(node, f"{target.value.id} holds numbers of the model, which are never changed")
        return element

    def _check_name(self, node: ast.stmt, name: str) -> None:
        """Refuse an assignment to what is no local number, or counts a loop."""
        if name in self.counters:
            raise self.error(node, f"{name} counts a loop, and is not changed in it")
        if name in self.module.names or self.locals.get(name) in ELEMENT:
            raise self.error(node, f"{name} is already the name of something else")

    def _if(self, node: ast.If, word: str, path: Path, depth: int, end: int) -> None:
        self._put(depth, f"{word} ({self.condition(node.test).text}) {{", node.lineno, node.test.end_lineno or 0)
        before = set(self.assigned or ())
        self._block(node.body, (*path, id(node.body)), depth + 1, node.orelse[0].lineno if node.orelse else end)
        after, self.assigned = self.assigned, before
        match node.orelse:
            case [ast.If() as other] if _is_elif(node):
                self._if(other, "} else if", path, depth, end)
            case []:
                self.lines.append(f"{INDENT * depth}}}")
            case other_block:
                self.lines.append(f"{INDENT * depth}}} else {{")
                self._block(other_block, (*path, id(other_block)), depth + 1, end)
                self.lines.append(f"{INDENT * depth}}}")
        if after is not None:
            self.assigned = after if self.assigned is None else self.assigned & after

    def _loop(self, node: ast.For | ast.While, head: str, path: Path, depth: int, end: int) -> None:
        """Print a loop, after which only what had a value before surely has one."""
        before = set(self.assigned or ())
        self.assigned = before | set(self.counters)
        self._put(depth, head, node.lineno, node.body[0].lineno - 1)
        self._block(node.body, (*path, id(node.body)), depth + 1, end)
        self.lines.append(f"{INDENT * depth}}}")
        self.assigned = before

    def _for(self, node: ast.For, name: str, bounds: list[ast.expr], path: Path, depth: int, end: int) -> None:
        self._check_name(node, name)
        home = self.homes.get(name)
        if name in self.definition.parameters or (home is not None and home == path[: len(home)]):
            raise self.error(node, f"{name} counts a loop, and is named outside it, too")
        terms = [self.of_type(bound, INT) for bound in bounds]
        first, last = (Term("0", INT), *terms[:2])[-2:]
        limit = bounds[min(1, len(bounds) - 1)]
        by = terms[2].text if len(terms) > 2 else "1"
        self.require(node, 1 <= len(terms) <= 3 and by.lstrip("-").strip("0").isdigit(), "a range has a literal step")
        step = int(by)
        changed = {part.id for part in ast.walk(node) if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)}
        fixed = isinstance(limit, ast.Constant) or (isinstance(limit, ast.Name) and limit.id not in changed)
        i = c_local(name)
        start = f"int64_t {i} = {first.text}" + ("" if fixed else f", {i}_end = {last.text}")
        stop = f"{i} {'<' if step > 0 else '>'} {last.within(ORDER) if fixed else f'{i}_end'}"
        move = f"{i}++" if step == 1 else f"{i} += {step}" if step > 0 else f"{i} -= {-step}"
        self.counters.append(name)
        self.locals[name] = INT
        self._loop(node, f"for ({start}; {stop}; {move}) {{", path, depth, end)
        self.counters.pop()
