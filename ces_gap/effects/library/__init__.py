"""The library of effects, one module each: `library()` returns every form of every effect."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from ces_gap.effects.effect import Effect


@cache
def library() -> tuple[Effect, ...]:
    """Return every form of every effect, in the order of modules and of the classes that set `form` in them."""
    modules = [import_module(f"{__name__}.{name}") for name in sorted(m.name for m in iter_modules(__path__))]
    kinds = [kind for m in modules for kind in vars(m).values() if getattr(kind, "__module__", "") == m.__name__]
    return tuple(kind() for kind in kinds if isinstance(kind, type) and issubclass(kind, Effect) and kind.form)
