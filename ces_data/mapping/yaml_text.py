"""Values as the text of a proposed YAML file."""

from __future__ import annotations

import json
import re

PLAIN = re.compile(r"/?[A-Za-z_][A-Za-z0-9_./]*")


def on_one_line(text: object) -> str:
    """Return a text for a comment that is not wrapped, in which a control character is written as Python does."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(text))


def quote(text: str) -> str:
    """Return a text as a double-quoted YAML scalar."""
    return json.dumps(text, ensure_ascii=False)


def name_yaml(text: str) -> str:
    """Return a topic, type or field as a YAML scalar, quoted only if it holds more than letters, digits and /_."""
    return text if PLAIN.fullmatch(text) else quote(text)


def write_key(key: str | int) -> str:
    """Return the name or number of a column."""
    return str(key) if isinstance(key, int) else quote(key)


def format_number(value: float) -> str:
    """Return a number as YAML reads it back: always a float, without rounding."""
    text = repr(float(value) + 0.0)
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{int(exponent):+d}" if mark else text
