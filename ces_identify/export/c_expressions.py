"""Expressions of the tick's subset of Python, checked and as C: their types, brackets and order of operations.

The order of operations is that of the source. C leaves open which operand of a sum, or which argument, comes first:
where that would show, because one of them stores into an array that another one reads, the source is refused.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

FLOAT, INT, BOOL, NONE, FLOATS, INTS = "double", "int64_t", "bool", "void", "double *", "int64_t *"
TYPES = {"float": FLOAT, "int": INT, "bool": BOOL, "Floats": FLOATS, "Ints": INTS}
ELEMENT = {FLOATS: FLOAT, INTS: INT}
WORDS = {FLOAT: "float", INT: "int", BOOL: "bool", NONE: "None", FLOATS: "Floats", INTS: "Ints"}
READ_ONLY = ("p", "n")  # the last part of the names of arrays that hold numbers of a model
SMALL = 1 << 15  # products of two such numbers fit into C's int

PRIMARY, UNARY, PRODUCT, SUM, ORDER, EQUAL, AND, OR, CHOICE = range(9, 0, -1)  # how tightly an operator binds
NOTHING, READS, STORES = range(3)  # what an expression does to elements of arrays

SIGNS: Mapping[type[ast.operator], tuple[str, int]] = {
    ast.Add: ("+", SUM), ast.Sub: ("-", SUM), ast.Mult: ("*", PRODUCT), ast.Div: ("/", PRODUCT),
    ast.FloorDiv: ("/", PRODUCT), ast.Mod: ("%", PRODUCT),
}  # fmt: skip
RELATIONS: Mapping[type[ast.cmpop], tuple[str, int]] = {
    ast.Lt: ("<", ORDER), ast.LtE: ("<=", ORDER), ast.Gt: (">", ORDER), ast.GtE: (">=", ORDER),
    ast.Eq: ("==", EQUAL), ast.NotEq: ("!=", EQUAL),
}  # fmt: skip
EXACT = ("sqrt", "floor", "copysign", "isfinite")  # the same number from every library and compiler
MATH = dict.fromkeys(("sqrt", "exp", "log", "sin", "cos", "tanh", "floor", "isfinite"), 1) | {"pow": 2, "copysign": 2}
C_WORDS = """auto bool break case char const continue default do double else enum extern fabs false float floor for goto
if inline int llabs long register restrict return short signed sizeof static struct switch true typedef typeof union
unsigned void volatile while"""
RESERVED = frozenset(C_WORDS.split())


class SubsetError(Exception):
    """A source of the tick holds what is not in its subset of Python."""


class Term(NamedTuple):
    """An expression in C: its text, type, how tightly its outermost operator binds, and what it does to arrays."""

    text: str
    type: str
    rank: int = PRIMARY
    effect: int = NOTHING

    def within(self, rank: int) -> str:
        """Return the text as an operand of an operator of this rank, in brackets where C needs them."""
        return self.text if self.rank > rank else f"({self.text})"


@dataclass(eq=False)
class Function:
    """A function of the tick; `stored` are the arrays that it stores into itself, `passed` those it passes on.

    An item of `passed` is its own array, the function that is called, and the place among the arguments.
    """

    name: str
    node: ast.FunctionDef
    module: Module
    parameters: dict[str, str]
    result: str
    stored: set[str] = field(default_factory=set)
    passed: list[tuple[str, Function, int]] = field(default_factory=list)
    calls: list[Function] = field(default_factory=list)

    @property
    def c_name(self) -> str:
        """Its name in C."""
        return f"ces_{self.name.lstrip('_')}"

    def stores(self, parameter: str) -> bool:
        """Return whether it or what it calls stores into an array."""
        return parameter in self.stored or any(
            function.stores(list(function.parameters)[place])
            for own, function, place in self.passed
            if own == parameter and place < len(function.parameters)
        )

    @property
    def prototype(self) -> str:
        """Its declaration in C, without the linkage."""
        written = [
            f"const {kind}{c_local(name)}" if kind in ELEMENT and not self.stores(name) else
            f"{kind}{'' if kind in ELEMENT else ' '}{c_local(name)}"
            for name, kind in self.parameters.items()
        ]  # fmt: skip
        return f"{self.result} {self.c_name}({', '.join(written) or 'void'})"


def c_local(name: str) -> str:
    """Return the name of a local in C."""
    return f"{name}_" if name in RESERVED else name


@dataclass(eq=False)
class Module:
    """What a module of the tick can see: constants as terms, functions, and names of `math`."""

    file: str
    terms: dict[str, Term] = field(default_factory=dict)
    functions: dict[str, Function] = field(default_factory=dict)
    math: set[str] = field(default_factory=set)

    @property
    def names(self) -> set[str]:
        """All of them."""
        return self.math | self.terms.keys() | self.functions.keys()

    def error(self, node: ast.AST, what: str = "") -> SubsetError:
        """Return the error for a node."""
        code = ast.unparse(node).partition("\n")[0]
        return SubsetError(f"{self.file}:{getattr(node, 'lineno', 1)}: {what or f'`{code}` is not in the subset'}")

    def require(self, node: ast.AST, fulfilled: bool, what: str) -> None:
        """Raise SubsetError unless something is fulfilled."""
        if not fulfilled:
            raise self.error(node, what)


class Expressions:
    """Prints the expressions of one function, or those of a module's constants."""

    def __init__(self, module: Module, function: Function | None = None) -> None:
        self.module, self.function = module, function
        self.require, self.error = module.require, module.error
        self.locals: dict[str, str] = dict(function.parameters) if function else {}
        self.assigned: set[str] | None = set(self.locals)  # surely, at this point; None where it is never reached

    def term(self, node: ast.expr) -> Term:  # noqa: PLR0911  # one for each kind
        """Return an expression in C."""
        match node:
            case ast.Constant(value=bool() as value):
                return Term("true" if value else "false", BOOL)
            case ast.Constant(value=int() as value) if value < 1 << 63:
                return Term(f"{value}" if value < SMALL else f"INT64_C({value})", INT)
            case ast.Constant(value=float() as value):
                return Term(repr(value), FLOAT)
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.Subscript(value=ast.Name(id=name), slice=index):
                kind, at = self.locals.get(name, NONE), self.of_type(index, INT)
                self.require(node, kind in ELEMENT, f"{name} is no array: Floats or Ints, given to the function")
                return Term(f"{c_local(name)}[{at.text}]", ELEMENT[kind], PRIMARY, max(READS, at.effect))
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                term = self.term(operand)
                self.require(node, term.type in (FLOAT, INT), "only a float or an int has a sign")
                return term._replace(text=f"-{term.within(UNARY)}", rank=UNARY)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                term = self.condition(operand)
                return Term(f"!{term.within(UNARY - 1)}", BOOL, UNARY, term.effect)
            case ast.BinOp(left=left, op=operator, right=right):
                return self.arithmetic(node, self.term(left), operator, self.term(right))
            case ast.Compare():
                return self._comparison(node)
            case ast.BoolOp(op=operator, values=values):
                terms = [self.condition(value) for value in values]
                sign, rank = ("&&", AND) if isinstance(operator, ast.And) else ("||", OR)
                text = f" {sign} ".join(term.within(AND) for term in terms)
                return Term(text, BOOL, rank, max(term.effect for term in terms))
            case ast.IfExp(test=test, body=body, orelse=orelse):
                condition, yes, no = self.condition(test), self.term(body), self.term(orelse)
                self.same_type(node, yes, no)
                text = f"{condition.within(CHOICE)} ? {yes.within(CHOICE)} : {no.within(CHOICE - 1)}"
                return Term(text, yes.type, CHOICE, max(condition.effect, yes.effect, no.effect))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self._call(node, name, arguments)
        raise self.error(node)

    def of_type(self, node: ast.expr, kind: str) -> Term:
        """Return an expression of this type."""
        term = self.term(node)
        what = f"`{ast.unparse(node)}` has type {WORDS[term.type]}; expected {WORDS[kind]}"
        self.require(node, term.type == kind, what)
        return term

    def condition(self, node: ast.expr) -> Term:
        """Return a condition."""
        return self.of_type(node, BOOL)

    def same_type(self, node: ast.AST, left: Term, right: Term) -> None:
        """Refuse two types in one operation."""
        what = f"{WORDS[left.type]} and {WORDS[right.type]} are mixed; convert by float() or int()"
        self.require(node, left.type == right.type, what)

    def effect(self, node: ast.AST, *terms: Term) -> int:
        """Return what several terms do, of which C may compute any one first; refuse if that could show."""
        effects = sorted(term.effect for term in terms)
        what = "C leaves open whether an element is read or stored first; assign the result of the call to a local"
        self.require(node, len(effects) < 2 or effects[-1] < STORES or effects[-2] == NOTHING, what)
        return effects[-1] if effects else NOTHING

    def _name(self, node: ast.Name, name: str) -> Term:
        if name in self.locals:
            self.require(node, self.assigned is None or name in self.assigned, f"{name} may have no value here")
            return Term(c_local(name), self.locals[name])
        if name in self.module.terms:
            return self.module.terms[name]
        raise self.error(node, f"{name} is no local with a value, constant or imported name here")

    def arithmetic(self, node: ast.AST, left: Term, operator: ast.operator, right: Term) -> Term:
        """Return an operation on two terms."""
        sign, rank = SIGNS.get(type(operator), ("", 0))
        self.require(node, rank > 0, f"the operator {type(operator).__name__} is not in the subset")
        self.same_type(node, left, right)
        kinds = {ast.Div: (FLOAT,), ast.FloorDiv: (INT,), ast.Mod: (INT,)}.get(type(operator), (FLOAT, INT))
        what = f"the operator {type(operator).__name__} takes {' or '.join(WORDS[kind] for kind in kinds)} only"
        self.require(node, left.type in kinds, what)
        text = f"{left.within(rank - 1)} {sign} {right.within(rank)}"
        return Term(text, left.type, rank, self.effect(node, left, right))

    def _comparison(self, node: ast.Compare) -> Term:
        terms = [self.term(part) for part in (node.left, *node.comparators)]
        effect, texts = self.effect(node, *terms), []
        once = all(term.effect < STORES for term in terms[1:-1])
        self.require(node, once, "a call in the middle of a chain would run twice in C; assign its result to a local")
        for left, operator, right in zip(terms, node.ops, terms[1:], strict=False):
            sign, rank = RELATIONS.get(type(operator), ("", 0))
            self.require(node, rank > 0, f"the comparison {type(operator).__name__} is not in the subset")
            self.same_type(node, left, right)
            numbers = left.type in (FLOAT, INT) or (left.type == BOOL and rank == EQUAL)
            self.require(node, numbers, f"a {WORDS[left.type]} is not compared")
            texts.append(f"{left.within(ORDER)} {sign} {right.within(ORDER)}")
        return Term(" && ".join(texts), BOOL, AND if len(texts) > 1 else rank, effect)

    def _call(self, node: ast.Call, name: str, arguments: list[ast.expr]) -> Term:
        if name in self.module.functions and name not in self.locals:
            return self._call_function(node, self.module.functions[name], arguments)
        terms = [self.term(argument) for argument in arguments]
        kinds, effect = [term.type for term in terms], self.effect(node, *terms)
        inner = ", ".join(term.text for term in terms)
        if name in self.module.math:
            self.require(node, kinds == [FLOAT] * MATH[name], f"{name} takes {MATH[name]} float(s)")
            what = f"{name} of a constant, which compilers compute otherwise than a library; write the number itself"
            self.require(node, name in EXACT or not any(map(self._is_fixed, arguments)), what)
            if name == "floor":
                return Term(f"({INT})floor({inner})", INT, UNARY, effect)
            return Term(f"{name}({inner})", BOOL if name == "isfinite" else FLOAT, PRIMARY, effect)
        match name, kinds:
            case "abs", ["double"]:
                return Term(f"fabs({inner})", FLOAT, PRIMARY, effect)
            case "abs", ["int64_t"]:
                return Term(f"({INT})llabs({inner})", INT, UNARY, effect)
            case ("float", ["int64_t"]) | ("int", ["double" | "bool"]):
                kind = TYPES[name]
                return Term(f"({kind}){terms[0].within(UNARY - 1)}", kind, UNARY, effect)
        raise self.error(node)

    def _call_function(self, node: ast.Call, function: Function, arguments: list[ast.expr]) -> Term:
        self.require(node, self.function is not None, "a constant calls no function")
        count = len(function.parameters)
        self.require(node, len(arguments) == count, f"{function.name} takes {count} arguments")
        terms = []
        for argument, kind in zip(arguments, function.parameters.values(), strict=True):
            self.require(node, kind not in ELEMENT or isinstance(argument, ast.Name), "an array is passed by its name")
            terms.append(self.of_type(argument, kind))
        stores = any(function.stores(parameter) for parameter in function.parameters)
        effect = max(self.effect(node, *terms), STORES if stores else READS)
        return Term(f"{function.c_name}({', '.join(term.text for term in terms)})", function.result, PRIMARY, effect)

    def _is_fixed(self, node: ast.expr) -> bool:
        """Return whether an expression holds constants only."""
        return not any(
            isinstance(part, ast.Subscript | ast.Call) or (isinstance(part, ast.Name) and part.id in self.locals)
            for part in ast.walk(node)
        )
