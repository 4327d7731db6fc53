"""Numbers and identifiers as C reads them."""

from __future__ import annotations

from math import isfinite

from ces_observer.errors import ModelError


def number(value: float) -> str:
    """Return a C literal of type double that reads back as exactly `value`. Raises ModelError if it is not finite."""
    if not isfinite(value):
        raise ModelError(f"the model holds {value!r}; expected finite numbers only")
    return repr(float(value))


def constructed_variable(name: str) -> str:
    """Return the variable of a constructed input."""
    return f"made_{name}"
