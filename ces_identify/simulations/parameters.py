"""Named numbers that a simulation declares and that may be fitted: their default, bounds and unit.

A Python function declares them by keyword-only arguments with defaults, `def force(time_s, position_m, current_A, *,
knee_m_s=0.12)`, the unit at the end of the name; an FMU by its variables of causality parameter. Those of a hydraulic
model follow from its parts (`hydraulic_parameters`).
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any


@dataclass(frozen=True)
class Parameter:
    """A number of a simulation by `name`: its `default`, and what is possible, [`low`, `high`].

    One that is `whole` counts something and never changes by a fraction. `unit` is empty where the name ends with it.
    """

    name: str
    default: float
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    whole: bool = False


def declared_parameters(function: Callable[..., Any], values: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Return the finite numbers among the keyword-only arguments of a function; `values` replace their defaults.

    Switches (bool), texts and whatever else is no number are settings and left out.
    """
    try:
        arguments = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):  # compiled code without a signature
        return ()
    numbers = [a for a in arguments if a.kind is a.KEYWORD_ONLY and is_number(a.default)]
    found = [Parameter(a.name, float(a.default), whole=isinstance(a.default, int)) for a in numbers]
    return with_defaults(found, values)


def is_number(value: object) -> bool:
    """Return whether a default is a finite number, of Python or of NumPy, and no switch."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def with_defaults(parameters: Iterable[Parameter], values: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Return the parameters with the `values` as their defaults."""
    return tuple(replace(p, default=float(values.get(p.name, p.default))) for p in parameters)
