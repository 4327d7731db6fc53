"""Statements of the tick's subset of Python, checked and as C, with their comments, docstrings and line breaks.

A local is declared at its first assignment if the block there holds all that names it, else at the top of the function.
No declaration needs a value, as nothing is read that may have none.
"""

from __future__ import annotations

import ast
import io
import re
import textwrap
import tokenize

from ces_identify.export.c_expressions import BOOL, INT, NONE, NUMBERS, OPERATORS, WORDS, CTerm, Expressions, Function

WIDTH = 120
INDENT = "    "
FOR_TOOLS = ("noqa", "type:", "fmt:", "pragma", "ruff:", "mypy:")  # comments that say nothing to a reader


class Comments:
    """The comments of a module, taken in their order as its statements are printed."""

    def __init__(self, source: str) -> None:
        tokens = tokenize.generate_tokens(io.StringIO(source).readline)
        said = [(token.start[0], token.string.lstrip("# ")) for token in tokens if token.type == tokenize.COMMENT]
        self.waiting = [(line, text) for line, text in said if not text.startswith(FOR_TOOLS)]

    def take(self, last: int) -> list[str]:
        """Take all comments up to a line of the source that are not taken yet."""
        taken = [text for line, text in self.waiting if line <= last]
        self.waiting = self.waiting[len(taken) :]
        return taken

    def above(self, line: int, depth: int = 0) -> list[str]:
        """Take those above a line, as lines of C."""
        return [f"{INDENT * depth}// {text}" for text in self.take(line - 1)]


def block_comment(text: str, title: str = "") -> list[str]:
    """Return a docstring as a comment of C; nothing for none."""
    lines = text.replace("*/", "* /").replace("/*", "/ *").splitlines()
    lines = [*([title, ""] if title else []), *lines]
    if len(lines) < 2:
        return [f"/* {line} */" for line in lines]
    return [f"/* {lines[0]}", *(f" * {line}".rstrip() for line in lines[1:]), " */"]


def wrap(code: str, depth: int = 0, comment: str = "") -> list[str]:
    """Return code as lines that are not too long, with a comment at the end, or above if there is no room."""
    room = WIDTH - len(INDENT) * depth
    bound = re.sub(r"\b(const|double|int64_t|bool|[=*]) ", "\\1\0", code)  # a NUL is a space that is not broken
    lines = textwrap.wrap(bound, room, subsequent_indent=INDENT, break_long_words=False, break_on_hyphens=False)
    lines = [line.replace("\0", " ") for line in lines]
    if comment and len(lines[-1]) + len(comment) + 5 <= room:
        lines[-1] += f"  // {comment}"
    elif comment:
        lines[:0] = [f"// {text}" for text in textwrap.wrap(comment, room - 3, break_on_hyphens=False)]
    return [INDENT * depth + line for line in lines]


class FunctionPrinter(Expressions):
    """Prints one function."""

    def __init__(self, function: Function, comments: Comments) -> None:
        super().__init__(function.module, function.parameters)
        self.function, self.comments = function, comments
        self.spans: dict[str, tuple[int, int]] = {}  # of each name: the first and the last line with it
        self.lines: list[str] = []
        self.declared = dict.fromkeys(self.locals, "")  # with its declaration at the top of the function, if any
        self.depth, self.block_end = 0, 0
        self.counters: list[str] = []  # of the loops around this place

    def text(self, linkage: str) -> list[str]:
        """Return the definition, with docstring and comments."""
        node, docstring = self.function.node, ast.get_docstring(self.function.node) or ""
        body = node.body[1:] if docstring else node.body
        for statement in body:
            self._find_spans(statement, frozenset())
        self._block(body)
        unused = [f"(void){name};" for name in self.function.parameters if name not in self.spans]
        top = [INDENT + line for line in (*unused, *filter(None, self.declared.values()))]
        head = [*block_comment(docstring), *wrap(f"{linkage}{self.function.prototype} {{")]
        return [*head, *top, *self.lines, "}"]

    def _find_spans(self, node: ast.AST, counters: frozenset[str]) -> None:
        """Note between which lines each name stands; a counter is none of them in its loop."""
        if isinstance(node, ast.For):
            counters |= {ast.unparse(node.target)}
        if isinstance(node, ast.Name) and node.id not in counters:
            first, last = self.spans.get(node.id, (node.lineno, node.lineno))
            self.spans[node.id] = min(first, node.lineno), max(last, node.lineno)
        for part in ast.iter_child_nodes(node):
            self._find_spans(part, counters)

    def _put(self, text: str, node: ast.AST | None = None) -> None:
        """Write a line, with what the source says beside the node that it is made from."""
        comment = " ".join(self.comments.take(getattr(node, "end_lineno", 0)))
        self.lines += wrap(text, self.depth, comment)

    def _block(self, block: list[ast.stmt]) -> None:
        around, self.block_end = self.block_end, block[-1].end_lineno or 0
        self.depth += 1
        for node in block:
            self.lines += self.comments.above(node.lineno, self.depth)
            self._statement(node)
        self.depth -= 1
        self.block_end = around

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign(targets=[target], value=value):
                term = self.term(value)
                self._put(f"{self._target(node, target, term)} = {term.text};", node)
            case ast.AugAssign(target=target, op=operator, value=value):
                term = self.term(value)
                self.operation(node, self.term(target), operator, term)
                self._put(f"{self._target(node, target, term)} {OPERATORS[type(operator)][0]}= {term.text};", node)
            case ast.Expr(value=ast.Call() as call):
                term = self.term(call)
                self._put(f"{'' if term.type == NONE else '(void)'}{term.text};", node)
            case ast.Return(value=value):
                term = self.term(value) if value else CTerm("", NONE)
                what = f"the result has type {WORDS[term.type]}; expected {WORDS[self.function.result]}"
                self.require(node, term.type == self.function.result, what)
                self._put(f"return {term.text};" if value else "return;", node)
            case ast.Break() | ast.Continue() | ast.Pass():
                self._put({ast.Break: "break;", ast.Continue: "continue;", ast.Pass: ";"}[type(node)], node)
            case ast.If():
                self._if(node, "if")
            case ast.While(test=test, body=body, orelse=[]):
                self._loop(f"while ({self.of_type(test, BOOL).text}) {{", test, body)
            case ast.For(target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="range")) as call, orelse=[]):
                self._for(node, name, call)
            case _:
                raise self.error(node)
        if isinstance(node, ast.Return | ast.Break | ast.Continue):  # what follows is never reached
            self.assigned = frozenset({*self.spans, *self.counters})

    def _target(self, node: ast.stmt, target: ast.expr, value: CTerm) -> str:
        """Return the left side of an assignment, with a declaration where there is none."""
        self.require(node, value.type in NUMBERS, "only numbers are assigned, to one name or element")
        if isinstance(target, ast.Subscript):
            element = self.term(target)
            self.same_type(node, element, value)
            self.effect(node, self.term(target.slice), value)
            return element.text
        if not isinstance(target, ast.Name):
            raise self.error(node)
        name, kind = target.id, self.locals.setdefault(target.id, value.type)
        self.require(node, name not in self.counters, f"{name} counts a loop, and is not changed in it")
        what = f"{name} has type {WORDS[kind]}, and type {WORDS[value.type]} here"
        self.require(node, kind == value.type, what)
        self.assigned |= {name}
        if name in self.declared:
            return name
        first, last = self.spans[name]
        is_here = node.lineno <= first and last <= self.block_end
        self.declared[name] = "" if is_here else f"{kind} {name};"
        return f"{kind} {name}" if is_here else name

    def _if(self, node: ast.If, word: str) -> None:
        self._put(f"{word} ({self.of_type(node.test, BOOL).text}) {{", node.test)
        before = self.assigned
        self._block(node.body)
        after, self.assigned = self.assigned, before
        match node.orelse:
            case [ast.If() as other]:
                self._if(other, "} else if")
            case others:
                if others:
                    self._put("} else {")
                    self._block(others)
                self._put("}")
        self.assigned &= after

    def _loop(self, head: str, node: ast.expr, body: list[ast.stmt]) -> None:
        """Print a loop, after which only what had a value before surely has one."""
        before = self.assigned
        self.assigned |= set(self.counters)
        self._put(head, node)
        self._block(body)
        self._put("}")
        self.assigned = before

    def _for(self, node: ast.For, name: str, call: ast.Call) -> None:
        is_new = name not in self.assigned and self.locals.setdefault(name, INT) == INT
        self.require(node, is_new, f"{name} counts a loop, and is named outside it, too")
        terms = [self.of_type(bound, INT) for bound in call.args]
        by = terms[2].text if len(terms) > 2 else "1"
        self.require(node, 1 <= len(terms) <= 3 and by.lstrip("-").strip("0").isdigit(), "a range has a literal step")
        first, last = ("0", *(term.text for term in terms[:2]))[-2:]
        changed = {part.id for part in ast.walk(node) if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)}
        start = f"int64_t {name} = {first}"
        if (not last.isidentifier() and not last.isdigit()) or last in changed:
            start, last = f"{start}, {name}_end = {last}", f"{name}_end"
        sign, move = ("<", f"+= {by}") if int(by) > 0 else (">", f"-= {by[1:]}")
        move = f"{name}{'++' if by == '1' else f' {move}'}"
        self.counters.append(name)
        self._loop(f"for ({start}; {name} {sign} {last}; {move}) {{", call, node.body)
        self.counters.pop()
