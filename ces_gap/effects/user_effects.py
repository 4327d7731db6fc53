"""Effects that a user wrote: `module:Class` in, a checked effect out, and back."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

import numpy as np

from ces_gap.effects.effect import Effect, EffectParameter
from ces_gap.effects.library import library
from ces_gap.errors import GapError
from ces_gap.trace import Trace

EXPECTED = "module:Class on PYTHONPATH, a subclass of ces_gap.effects.effect.Effect"
MAX_SPEC_LENGTH = 200


def user_effect(spec: str) -> Effect:
    """Return the effect that `module:Class` names, imported and made without arguments.

    Raises GapError if it cannot be, is no effect, lacks a name, a form or parameters, or if the library has its name
    and form already. Importing runs the module: only from whom you trust.
    """
    module, _, name = spec.partition(":")
    if not module or not name.isidentifier() or len(spec) > MAX_SPEC_LENGTH:
        raise GapError(f"effect '{spec[:MAX_SPEC_LENGTH]}': expected {EXPECTED}")
    try:
        found = getattr(import_module(module), name)
        effect = found() if isinstance(found, type) and issubclass(found, Effect) else None
    except Exception as error:  # whatever a user's module raises
        told = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise GapError(f"effect '{spec}': cannot be imported: {told}; expected {EXPECTED}") from None
    if effect is None:
        raise GapError(f"effect '{spec}': is no effect; expected {EXPECTED}")
    _require_description(spec, effect)
    return effect


def class_of(effect: Effect) -> str | None:
    """Return `module:Class` of a user's effect, None for one of the library."""
    if any(type(form) is type(effect) and form.form == effect.form for form in library()):
        return None
    kind = type(effect)
    return f"{kind.__module__}:{kind.__qualname__}"


def library_effect(name: str, form: str) -> Effect:
    """Return a form of an effect of the library; raises GapError naming those there are."""
    forms = [e for e in library() if e.name == name]
    if not forms:
        raise GapError(f"no effect '{name}'; there are {', '.join(dict.fromkeys(e.name for e in library()))}")
    for effect in forms:
        if effect.form == form:
            return effect
    raise GapError(f"effect '{name}' has no form '{form}'; it has {', '.join(e.form for e in forms)}")


def require_sound(effect: Effect, trace: Trace) -> None:
    """Raise GapError unless the effect runs on `trace` at its starts and gives finite arrays of the trace's length."""
    values = [p.starts[0] for p in effect.parameters]
    try:
        inputs = effect.drive(trace, trace.inputs, trace.simulated, values)
        force = effect.respond(trace, inputs, trace.simulated, values)
    except Exception as error:  # whatever a user's class raises
        raise GapError(
            f"effect '{effect.name}': raised {type(error).__name__}: {' '.join(str(error).split())}"
        ) from error
    given = {"position": inputs.position, "speed": inputs.speed, "current": inputs.current, "force": force}
    for name, array in given.items():
        if np.shape(array) != trace.time_s.shape:
            raise GapError(
                f"effect '{effect.name}': gave {name} of shape {np.shape(array)}; expected {trace.time_s.shape}"
            )
        if not np.isfinite(array).all():
            raise GapError(f"effect '{effect.name}': gave a {name} that is not finite at its starts {values}")


def _require_description(spec: str, effect: Effect) -> None:
    if not (effect.name and effect.form and effect.parameters):
        raise GapError(f"effect '{spec}': has no name, form or parameters; expected all three as class variables")
    for parameter in effect.parameters:
        _require_sensible(spec, parameter)
    if any(e.name == effect.name and e.form == effect.form for e in library()):
        raise GapError(
            f"effect '{spec}': the library has {effect.name} ({effect.form}) already; give it a form or name of its own"
        )


def _require_sensible(spec: str, parameter: EffectParameter) -> None:
    inside: Sequence[bool] = [parameter.low <= start <= parameter.high for start in parameter.starts]
    if not parameter.low < parameter.high or not inside or not all(inside):
        raise GapError(
            f"effect '{spec}': {parameter.name} has bounds [{parameter.low:g}, {parameter.high:g}] and starts "
            f"{parameter.starts}; expected low < high and at least one start between them"
        )
