"""The effects that a diagnosis fits: those of the library, one module each, and those of the user, `module:Class`."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

import numpy as np

from ces_gap.effects.effect import Effect
from ces_gap.effects.simulation_errors import simulation_errors
from ces_gap.errors import GapError
from ces_gap.trace import Trace

EXPECTED = "module:Class on PYTHONPATH, a subclass of ces_gap.Effect"
MAX_SPEC_LENGTH = 200


@cache
def library() -> tuple[Effect, ...]:
    """Return every form of every effect, in the order of modules and of the classes that set `form` in them."""
    modules = [import_module(f"{__name__}.{name}") for name in sorted(m.name for m in iter_modules(__path__))]
    kinds = [kind for m in modules for kind in vars(m).values() if getattr(kind, "__module__", "") == m.__name__]
    return tuple(kind() for kind in kinds if isinstance(kind, type) and issubclass(kind, Effect) and kind.form)


def user_effect(spec: str) -> Effect:
    """Import `module:Class` and return an instance of it. Importing runs the module: use trusted code only.

    Raises GapError if that fails, if the class is not a complete effect, or if the library has its name and form.
    """
    module, _, name = spec.partition(":")
    if not module or not name.isidentifier() or len(spec) > MAX_SPEC_LENGTH:
        raise GapError(f"effect '{spec[:MAX_SPEC_LENGTH]}': expected {EXPECTED}")
    try:
        kind = getattr(import_module(module), name)
        effect = kind() if isinstance(kind, type) and issubclass(kind, Effect) else None
    except Exception as error:  # the module of a user may raise anything
        text = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise GapError(f"effect '{spec}': cannot be imported: {text}; expected {EXPECTED}") from None
    if effect is None:
        raise GapError(f"effect '{spec}': not an effect; expected {EXPECTED}")
    if not (effect.name and effect.form and effect.parameters):
        raise GapError(f"effect '{spec}': expected name, form and parameters as class variables")
    for p in effect.parameters:
        if not (p.low < p.high and p.starts and all(p.low <= start <= p.high for start in p.starts)):
            raise GapError(
                f"effect '{spec}': {p.name} has bounds [{p.low:g}, {p.high:g}] and starts {p.starts}; expected low < "
                "high and at least one start between them"
            )
    if any((e.name, e.form) == (effect.name, effect.form) for e in library()):
        has = f"the library already has {effect.name} ({effect.form})"
        raise GapError(f"effect '{spec}': {has}; choose another name or form")
    return effect


def class_of(effect: Effect) -> str | None:
    """Return `module:Class` of an effect of the user, None for one of the library."""
    kind = type(effect)
    forms = {(type(form), form.form) for form in (*library(), *simulation_errors())}
    return None if (kind, effect.form) in forms else f"{kind.__module__}:{kind.__qualname__}"


def library_effect(name: str, form: str) -> Effect:
    """Return a form of an effect of the library; raises GapError if there is none."""
    effects = (*library(), *simulation_errors())
    forms = {e.form: e for e in effects if e.name == name}
    if not forms:
        raise GapError(f"unknown effect '{name}'; expected {', '.join(dict.fromkeys(e.name for e in effects))}")
    if form not in forms:
        raise GapError(f"effect '{name}' has no form '{form}'; expected {', '.join(forms)}")
    return forms[form]


def require_sound(effect: Effect, trace: Trace) -> None:
    """Raise GapError unless the effect runs on `trace` at its starts and returns finite arrays (n,)."""
    values, where = [p.starts[0] for p in effect.parameters], f"effect '{effect.name}'"
    try:
        inputs = effect.drive(trace, trace.inputs, trace.simulated, values)
        force = effect.respond(trace, inputs, trace.simulated, values)
    except Exception as error:  # the class of a user may raise anything
        raise GapError(f"{where}: raised {type(error).__name__}: {' '.join(str(error).split())}") from error
    results = {"position": inputs.position, "speed": inputs.speed, "current": inputs.current, "force": force}
    for name, array in results.items():
        if np.shape(array) != trace.time_s.shape:
            raise GapError(f"{where}: returned {name} of shape {np.shape(array)}; expected {trace.time_s.shape}")
        if not np.isfinite(array).all():
            raise GapError(f"{where}: returned a {name} that is not finite at its starts {values}")
