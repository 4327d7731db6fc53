"""Expressions of the tick's subset of Python, checked and as C: their types, brackets and order of operations.

The order of operations is that of the source. C leaves open which operand of a sum, or which argument, comes first:
where that would show, because one of them stores into an array that another one reads, the source is refused.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

FLOAT, INT, BOOL, NONE, FLOATS, INTS = "double", "int64_t", "bool", "void", "double *", "int64_t *"
TYPES = {"float": FLOAT, "int": INT, "bool": BOOL, "None": NONE, "Floats": FLOATS, "Ints": INTS}
WORDS = {kind: word for word, kind in TYPES.items()}
ELEMENT = {FLOATS: FLOAT, INTS: INT}
NUMBERS = (FLOAT, INT, BOOL)
SMALL = 1 << 15  # products of two such numbers fit into C's int

PRIMARY, UNARY, PRODUCT, SUM, ORDER, EQUAL, AND, OR, CHOICE = range(9, 0, -1)  # how tightly an operator binds
FIXED, VARIES, READS, STORES = range(4)  # what an expression depends on, or does to elements of arrays

OPERATORS: Mapping[type[ast.AST], tuple[str, int, tuple[str, ...]]] = {
    ast.Add: ("+", SUM, (FLOAT, INT)), ast.Sub: ("-", SUM, (FLOAT, INT)), ast.Mult: ("*", PRODUCT, (FLOAT, INT)),
    ast.Div: ("/", PRODUCT, (FLOAT,)), ast.FloorDiv: ("/", PRODUCT, (INT,)), ast.Mod: ("%", PRODUCT, (INT,)),
    ast.Lt: ("<", ORDER, (FLOAT, INT)), ast.LtE: ("<=", ORDER, (FLOAT, INT)), ast.Gt: (">", ORDER, (FLOAT, INT)),
    ast.GtE: (">=", ORDER, (FLOAT, INT)), ast.Eq: ("==", EQUAL, NUMBERS), ast.NotEq: ("!=", EQUAL, NUMBERS),
}  # fmt: skip
CALLS: Mapping[tuple[str, ...], tuple[str, str]] = {
    ("float", INT): ("(double)", FLOAT), ("int", FLOAT): ("(int64_t)", INT), ("int", BOOL): ("(int64_t)", INT),
    ("abs", FLOAT): ("fabs", FLOAT), ("abs", INT): ("(int64_t)llabs", INT),
    ("floor", FLOAT): ("(int64_t)floor", INT), ("isfinite", FLOAT): ("isfinite", BOOL),
    **{(name, FLOAT): (name, FLOAT) for name in ("sqrt", "exp", "log", "sin", "cos", "tanh")},
    **{(name, FLOAT, FLOAT): (name, FLOAT) for name in ("pow", "copysign")},
}  # fmt: skip
PART = "part"  # the part of an array from a place on
INEXACT = ("exp", "log", "sin", "cos", "tanh", "pow")  # which libraries and compilers round differently


class SubsetError(Exception):
    """A source of the tick holds what is not in its subset of Python."""


class CTerm(NamedTuple):
    """An expression in C: its text, type, how tightly its outermost operator binds, and what it does to arrays."""

    text: str
    type: str
    rank: int = PRIMARY
    effect: int = FIXED

    def within(self, rank: int) -> str:
        """Return the text as an operand of an operator of this rank, in brackets where C needs them."""
        return self.text if self.rank > rank else f"({self.text})"


OF_MATH = {"inf": CTerm("INFINITY", FLOAT), "nan": CTerm("NAN", FLOAT), "pi": CTerm(repr(math.pi), FLOAT)}


@dataclass(eq=False)
class Module:
    """A module of the tick: its own and imported names, which are constants as terms, or functions."""

    file: str
    docstring: str
    names: dict[str, CTerm | Function] = field(default_factory=dict)

    def error(self, node: ast.AST, what: str = "") -> SubsetError:
        """Return the error for a node."""
        code = ast.unparse(node).partition("\n")[0]
        return SubsetError(f"{self.file}:{getattr(node, 'lineno', 1)}: {what or f'`{code}` is not in the subset'}")

    def require(self, node: ast.AST, fulfilled: bool, what: str) -> None:
        """Raise SubsetError unless something is fulfilled."""
        if not fulfilled:
            raise self.error(node, what)

    def make_function(self, node: ast.FunctionDef) -> Function:
        """Return a function of this module, whose definition is printed later; raises SubsetError."""
        kinds = {item.arg: TYPES.get(ast.unparse(item.annotation or item), NONE) for item in node.args.args}
        result = TYPES.get(ast.unparse(node.returns), "") if node.returns else ""
        is_typed = NONE not in kinds.values() and result in (*NUMBERS, NONE)
        expected = "arguments Floats, Ints, float, int or bool, and a number or None as result"
        self.require(node, is_typed, f"{node.name}: expected {expected}")
        return Function(node, self, kinds, result)


def _array_of(argument: ast.expr) -> ast.expr:
    """Return the array of which an argument is a part, else the argument."""
    match argument:
        case ast.Call(func=ast.Name(id=name), args=[array, _]) if name == PART:
            return _array_of(array)
    return argument


@dataclass(eq=False)
class Function:
    """A function of the tick; `lines` are its definition in C, once it is printed."""

    node: ast.FunctionDef
    module: Module
    parameters: Mapping[str, str]
    result: str
    lines: list[str] = field(default_factory=list)
    _is_entered: bool = False

    @property
    def c_name(self) -> str:
        """Its name in C."""
        return f"ces_{self.node.name.lstrip('_')}"

    @cached_property
    def calls(self) -> list[tuple[Function, list[str]]]:
        """The functions of the tick that it calls, each with the texts of its arguments, of a part its array."""
        nodes = [(part, ast.unparse(part.func)) for part in ast.walk(self.node) if isinstance(part, ast.Call)]
        texts = ([ast.unparse(_array_of(argument)) for argument in part.args] for part, _ in nodes)
        called = [(self.module.names.get(name), arguments) for (_, name), arguments in zip(nodes, texts, strict=True)]
        return [(item, arguments) for item, arguments in called if isinstance(item, Function)]

    @cached_property
    def stored(self) -> set[str]:
        """The arrays that it, or what it calls, stores into. Raises SubsetError for a function that calls itself."""
        self.module.require(self.node, not self._is_entered, f"{self.node.name} calls itself")
        self._is_entered = True
        elements = [part for part in ast.walk(self.node) if isinstance(part, ast.Subscript)]
        own = {ast.unparse(part.value) for part in elements if isinstance(part.ctx, ast.Store)}
        for called, arguments in self.calls:
            pairs = zip(arguments, called.parameters, strict=False)
            own |= {argument for argument, parameter in pairs if parameter in called.stored}
        return own

    @property
    def prototype(self) -> str:
        """Its declaration in C, without the linkage."""
        written = []
        for name, kind in self.parameters.items():
            constant = "const " if kind in ELEMENT and name not in self.stored else ""
            written.append(f"{constant}{kind}{'' if kind in ELEMENT else ' '}{name}")
        return f"{self.result} {self.c_name}({', '.join(written) or 'void'})"


class Expressions:
    """Prints the expressions of one function, or those of a module's constants."""

    def __init__(self, module: Module, parameters: Mapping[str, str]) -> None:
        self.module, self.require, self.error = module, module.require, module.error
        self.locals = dict(parameters)
        self.assigned = frozenset(parameters)  # names that surely have a value at this point

    def term(self, node: ast.expr) -> CTerm:  # noqa: PLR0911  # one for each kind
        """Return an expression in C."""
        match node:
            case ast.Constant(value=bool() as value):
                return CTerm("true" if value else "false", BOOL)
            case ast.Constant(value=int() as value) if value < 1 << 63:
                return CTerm(f"{value}" if value < SMALL else f"INT64_C({value})", INT)
            case ast.Constant(value=float() as value):
                return CTerm(repr(value), FLOAT)
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.Subscript(value=ast.Name(id=name), slice=index):
                kind, at = self.locals.get(name, NONE), self.of_type(index, INT)
                self.require(node, kind in ELEMENT, f"{name} is no array: Floats or Ints, given to the function")
                return CTerm(f"{name}[{at.text}]", ELEMENT[kind], PRIMARY, max(READS, at.effect))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                term = self.term(operand)
                self.require(node, term.type in (FLOAT, INT), "only a float or an int has a sign")
                return term._replace(text=f"-{term.within(UNARY)}", rank=UNARY)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                term = self.of_type(operand, BOOL)
                return CTerm(f"!{term.within(UNARY - 1)}", BOOL, UNARY, term.effect)
            case ast.BinOp(left=left, op=operator, right=right):
                return self.operation(node, self.term(left), operator, self.term(right))
            case ast.Compare(left=left, ops=operators, comparators=others):
                return self._comparison(node, [self.term(part) for part in (left, *others)], operators)
            case ast.BoolOp(op=operator, values=values):
                terms = [self.of_type(value, BOOL) for value in values]
                sign, rank = ("&&", AND) if isinstance(operator, ast.And) else ("||", OR)
                text = f" {sign} ".join(term.within(AND) for term in terms)
                return CTerm(text, BOOL, rank, max(term.effect for term in terms))
            case ast.IfExp(test=test, body=body, orelse=orelse):
                condition, yes, no = self.of_type(test, BOOL), self.term(body), self.term(orelse)
                self.same_type(node, yes, no)
                text = f"{condition.within(CHOICE)} ? {yes.within(CHOICE)} : {no.within(CHOICE - 1)}"
                return CTerm(text, yes.type, CHOICE, max(condition.effect, yes.effect, no.effect))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self._call(node, name, [self.term(argument) for argument in arguments])
        raise self.error(node)

    def of_type(self, node: ast.expr, kind: str) -> CTerm:
        """Return an expression of this type."""
        term = self.term(node)
        what = f"`{ast.unparse(node)}` has type {WORDS[term.type]}; expected {WORDS[kind]}"
        self.require(node, term.type == kind, what)
        return term

    def same_type(self, node: ast.AST, left: CTerm, right: CTerm) -> None:
        """Refuse what is no number, and two types in one operation."""
        what = f"{WORDS[left.type]} and {WORDS[right.type]} are mixed; convert by float() or int()"
        self.require(node, left.type == right.type, what)
        self.require(node, left.type in NUMBERS, f"{WORDS[left.type]}: expected a number")

    def effect(self, node: ast.AST, *terms: CTerm) -> int:
        """Return what several terms do, of which C may compute any one first; refuse if that could show."""
        *_, second, largest = sorted((FIXED, FIXED, *(term.effect for term in terms)))
        what = "C leaves open whether an element is read or stored first; assign the result of the call to a local"
        self.require(node, largest < STORES or second < READS, what)
        return largest

    def operation(self, node: ast.AST, left: CTerm, operator: ast.AST, right: CTerm) -> CTerm:
        """Return an operation on two terms, or their comparison."""
        name = type(operator).__name__
        sign, rank, kinds = OPERATORS.get(type(operator), ("", 0, ()))
        self.require(node, rank > 0, f"the operator {name} is not in the subset")
        self.same_type(node, left, right)
        self.require(
            node, left.type in kinds, f"the operator {name} takes {' or '.join(WORDS[kind] for kind in kinds)} only"
        )
        effect = self.effect(node, left, right)
        if rank <= ORDER:
            return CTerm(f"{left.within(ORDER)} {sign} {right.within(ORDER)}", BOOL, rank, effect)
        return CTerm(f"{left.within(rank - 1)} {sign} {right.within(rank)}", left.type, rank, effect)

    def _name(self, node: ast.Name, name: str) -> CTerm:
        if name in self.locals:
            self.require(node, name in self.assigned, f"{name} may have no value here")
            return CTerm(name, self.locals[name], PRIMARY, VARIES)
        constant = self.module.names.get(name)
        if isinstance(constant, CTerm):
            return constant
        raise self.error(node, f"{name} is no local with a value, constant or imported name here")

    def _comparison(self, node: ast.Compare, terms: list[CTerm], operators: list[ast.cmpop]) -> CTerm:
        effect, once = self.effect(node, *terms), all(term.effect < STORES for term in terms[1:-1])
        self.require(node, once, "a call in the middle of a chain would run twice in C; assign its result to a local")
        parts = [self.operation(node, *part) for part in zip(terms, operators, terms[1:], strict=False)]
        text = " && ".join(part.text for part in parts)
        return CTerm(text, BOOL, AND if len(parts) > 1 else parts[0].rank, effect)

    def _call(self, node: ast.Call, name: str, terms: list[CTerm]) -> CTerm:
        effect, kinds = self.effect(node, *terms), [term.type for term in terms]
        inner, called = ", ".join(term.text for term in terms), self.module.names.get(name)
        if isinstance(called, Function):
            expected = list(called.parameters.values())
            self.require(node, kinds == expected, f"{name} takes {', '.join(WORDS[kind] for kind in expected)}")
            effect = max(effect, STORES if called.stored else READS)
            return CTerm(f"{called.c_name}({inner})", called.result, PRIMARY, effect)
        if name == PART and kinds in ([FLOATS, INT], [INTS, INT]):
            return CTerm(f"{terms[0].text} + {terms[1].within(SUM)}", kinds[0], SUM, effect)
        given = f"{name}({', '.join(WORDS[kind] for kind in kinds)})"
        self.require(node, (name, *kinds) in CALLS, f"{given} is not in the subset")
        what = f"{name} of a constant, which compilers compute otherwise than a library; write the number itself"
        self.require(node, effect > FIXED or name not in INEXACT, what)
        function, kind = CALLS[name, *kinds]
        if function.endswith(")"):
            return CTerm(function + terms[0].within(UNARY - 1), kind, UNARY, effect)
        return CTerm(f"{function}({inner})", kind, UNARY if function.startswith("(") else PRIMARY, effect)
