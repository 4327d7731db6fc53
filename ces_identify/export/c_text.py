"""Text of the exported C: templates, numbers and identifiers."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from math import isfinite

from jinja2 import Environment, FunctionLoader, StrictUndefined

from ces_observer.errors import ModelError


@dataclass(frozen=True)
class ConstantTable:
    """Constants of type double in C: an array, or one of rows of `width` numbers."""

    name: str
    values: Sequence[float]
    width: int = 0

    @property
    def definition(self) -> str:
        """The C text that defines it. Raises ModelError if a number is not finite."""
        shape = f"[{len(self.values) // self.width}][{self.width}]" if self.width else f"[{len(self.values)}]"
        step = self.width or len(self.values)
        rows = [self.values[k : k + step] for k in range(0, len(self.values), step)]
        texts = ["{" + ", ".join(map(number, row)) + "}" for row in rows]
        text = "{" + ", ".join(texts) + "}" if self.width else texts[0]
        return textwrap.fill(
            f"static const double {self.name}{shape} = {text};",
            118,
            subsequent_indent="    ",
            break_on_hyphens=False,
            break_long_words=False,
        )


def render(template: str, facts: Mapping[str, object]) -> str:
    """Return the text of templates/TEMPLATE.j2."""
    return _make_environment().get_template(template).render(facts)


def render_text(template: str, facts: Mapping[str, object]) -> str:
    """Return the text that the text of a template gives."""
    return _make_environment().from_string(template).render(facts)


def _make_environment() -> Environment:
    folder = resources.files("ces_identify.export") / "templates"
    environment = Environment(
        loader=FunctionLoader(lambda name: (folder / f"{name}.j2").read_text(encoding="utf-8")),
        autoescape=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(number=number, text=text_literal, variable=constructed_variable)
    return environment


def number(value: float) -> str:
    """Return a C literal of type double that reads back as exactly `value`. Raises ModelError if it is not finite."""
    if not isfinite(value):
        raise ModelError(f"the model holds {value!r}; expected finite numbers only")
    return repr(float(value))


def text_literal(text: str) -> str:
    """Return a string literal that C, C++ and YAML read alike. Raises ModelError for what cannot be printed."""
    if not text.isprintable():
        raise ModelError(f"{text!r}: expected printable characters")
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def constructed_variable(name: str) -> str:
    """Return the C variable of a constructed input."""
    return f"made_{name}"
