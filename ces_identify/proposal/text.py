"""Lines that both proposals share: comments that explain a choice, and numbers as YAML writes them."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterator, Sequence

from ces_identify.proposal.choice import Choice, NotFound
from ces_identify.proposal.rating import Rating

WIDTH = 110
MAX_OTHERS = 4
CHECK = "CHECK"
PLAIN = re.compile(r"/?[A-Za-z_][A-Za-z0-9_./]*")


def explain(choice: Choice, indent: str) -> Iterator[str]:
    """Yield the comment lines above a choice: reasons, range, checks, and what was not chosen."""
    c = choice.candidate
    yield from comment(f"{choice.signal}: {'; '.join(choice.reasons)}.", indent)
    yield from comment(f"range {c.low:.4g} to {c.high:.4g} as logged, {c.rate_Hz:.4g} Hz", indent)
    for check in choice.checks:
        yield from comment(f"{CHECK}: {check}", indent)
    yield from _list_others("not chosen", choice.others, indent)


def explain_missing(missing: NotFound, indent: str) -> Iterator[str]:
    """Yield the comment lines in the place of a signal that was not found."""
    yield from comment(f"not found: {missing.signal}: {missing.reason}", indent)
    yield from _list_others("candidates", missing.others, indent)


def comment(text: str, indent: str) -> Iterator[str]:
    """Yield a text as comment lines."""
    lines = textwrap.wrap(text, WIDTH - len(indent) - 2, break_long_words=False, break_on_hyphens=False)
    yield from (f"{indent}# {line if i == 0 else '  ' + line}" for i, line in enumerate(lines))


def one_line(text: object) -> str:
    """Return a text for a comment that is not wrapped, in which a control character is written as Python does."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(text))


def quote_yaml(text: str) -> str:
    """Return a text as a double-quoted YAML scalar."""
    return json.dumps(text, ensure_ascii=False)


def name_yaml(text: str) -> str:
    """Return a topic, type or field as a YAML scalar, quoted only if it holds more than letters, digits and /_."""
    return text if PLAIN.fullmatch(text) else quote_yaml(text)


def format_number(value: float) -> str:
    """Return a number as YAML reads it back: always a float, without rounding."""
    text = repr(float(value) + 0.0)
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{int(exponent):+d}" if mark else text


def describe_scale(choice: Choice) -> str:
    """Return what the scale does, such as `mm to m, sign turned`; '' if nothing."""
    unit = choice.unit.unit
    parts = [f"{unit.text} to SI"] if unit is not None and (unit.scale != 1.0 or unit.offset != 0.0) else []
    turned = choice.scale < 0.0
    return ", ".join([*parts, *(["sign turned"] if turned else [])])


def _list_others(title: str, others: Sequence[Rating], indent: str) -> Iterator[str]:
    shown = [f"{r.candidate.label} ({r.why})" for r in others[:MAX_OTHERS]]
    more = [f"{len(others) - MAX_OTHERS} more"] if len(others) > MAX_OTHERS else []
    if shown:
        yield from comment(f"{title}: {', '.join(shown + more)}", indent)
