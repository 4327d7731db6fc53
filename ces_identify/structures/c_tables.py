"""Numbers of a model as text of C: tables of constants, literals and names, for the C of every structure."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite

from ces_observer.errors import ModelError

ARGUMENTS = {"position": "position_m", "speed": "speed_m_s", "current": "current_A"}  # of a tick


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


def number(value: float) -> str:
    """Return a C literal of type double that reads back as exactly `value`. Raises ModelError if it is not finite."""
    if not isfinite(value):
        raise ModelError(f"the model holds {value!r}; expected finite numbers only")
    return repr(float(value))


def find_slopes(at: Sequence[float], values: Sequence[float]) -> list[float]:
    """Return the slopes of a curve's pieces."""
    return [(y1 - y0) / (x1 - x0) for (x0, x1), (y0, y1) in zip(pairwise(at), pairwise(values), strict=True)]


def constructed_variable(name: str) -> str:
    """Return the C variable of a constructed input."""
    return f"made_{name}"
