"""The library of effects, one module each: `library()` returns every form of every effect."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from ces_gap.effects.effect import Effect


def library() -> tuple[Effect, ...]:
    """Return every form of every effect, in the order of module names."""
    modules = sorted(m.name for m in iter_modules(__path__))
    return tuple(form for module in modules for form in import_module(f"{__name__}.{module}").FORMS)
