"""Text of the exported C: templates filled with values."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources

from jinja2 import Environment, FunctionLoader, StrictUndefined

from ces_identify.structures.c_tables import constructed_variable, number
from ces_observer.errors import ModelError


def render(template: str, facts: Mapping[str, object]) -> str:
    """Return the text of the template TEMPLATE.j2."""
    return _make_environment().get_template(template).render(facts)


def render_text(template: str, facts: Mapping[str, object]) -> str:
    """Return the text that the text of a template gives."""
    return _make_environment().from_string(template).render(facts)


def _make_environment() -> Environment:
    environment = Environment(
        loader=FunctionLoader(_load),
        autoescape=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(number=number, text=text_literal, variable=constructed_variable)
    return environment


def _load(name: str) -> str | None:
    """Return the text of a template: those of structures lie beside their modules, all others in templates/."""
    beside = resources.files("ces_identify.structures") / f"{name}.j2"
    general = resources.files("ces_identify.export") / "templates" / f"{name}.j2"
    return (beside if beside.is_file() else general).read_text(encoding="utf-8")


def text_literal(text: str) -> str:
    """Return a string literal that C, C++ and YAML read alike. Raises ModelError for what cannot be printed."""
    if not text.isprintable():
        raise ModelError(f"{text!r}: expected printable characters")
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
