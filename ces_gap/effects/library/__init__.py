"""The library of effects, one module each: `library()` returns every form of every effect."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from ces_gap.effects.effect import Effect


def library() -> tuple[Effect, ...]:
    """Return every form of every effect, in order of the modules' names."""
    forms: list[Effect] = []
    for module in sorted(m.name for m in iter_modules(__path__)):
        forms.extend(import_module(f"{__name__}.{module}").FORMS)
    return tuple(forms)


def effect_names() -> tuple[str, ...]:
    """Return the effects' names, each once."""
    return tuple(dict.fromkeys(form.name for form in library()))
