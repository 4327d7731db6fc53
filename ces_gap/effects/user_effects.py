"""Effects of the user: `module:Class` in, a checked effect out, and back."""

from __future__ import annotations

from importlib import import_module

import numpy as np

from ces_gap.effects.effect import Effect, EffectParameter
from ces_gap.effects.library import library
from ces_gap.effects.simulation_errors import simulation_errors
from ces_gap.errors import GapError
from ces_gap.trace import Trace

EXPECTED = "module:Class on PYTHONPATH, a subclass of ces_gap.Effect"
MAX_SPEC_LENGTH = 200


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
    _require_description(spec, effect)
    return effect


def class_of(effect: Effect) -> str | None:
    """Return `module:Class` of an effect of the user, None for one of the library."""
    if any(type(form) is type(effect) and form.form == effect.form for form in (*library(), *simulation_errors())):
        return None
    kind = type(effect)
    return f"{kind.__module__}:{kind.__qualname__}"


def library_effect(name: str, form: str) -> Effect:
    """Return a form of an effect of the library; raises GapError if there is none."""
    known = (*library(), *simulation_errors())
    forms = {e.form: e for e in known if e.name == name}
    if not forms:
        raise GapError(f"unknown effect '{name}'; expected {', '.join(dict.fromkeys(e.name for e in known))}")
    if form not in forms:
        raise GapError(f"effect '{name}' has no form '{form}'; expected {', '.join(forms)}")
    return forms[form]


def require_sound(effect: Effect, trace: Trace) -> None:
    """Raise GapError unless the effect runs on `trace` at its starts and returns finite arrays (n,)."""
    values = [p.starts[0] for p in effect.parameters]
    try:
        inputs = effect.drive(trace, trace.inputs, trace.simulated, values)
        force = effect.respond(trace, inputs, trace.simulated, values)
    except Exception as error:  # the class of a user may raise anything
        raise GapError(
            f"effect '{effect.name}': raised {type(error).__name__}: {' '.join(str(error).split())}"
        ) from error
    results = {"position": inputs.position, "speed": inputs.speed, "current": inputs.current, "force": force}
    for name, array in results.items():
        if np.shape(array) != trace.time_s.shape:
            raise GapError(
                f"effect '{effect.name}': returned {name} of shape {np.shape(array)}; expected {trace.time_s.shape}"
            )
        if not np.isfinite(array).all():
            raise GapError(f"effect '{effect.name}': returned a {name} that is not finite at its starts {values}")


def _require_description(spec: str, effect: Effect) -> None:
    if not (effect.name and effect.form and effect.parameters):
        raise GapError(f"effect '{spec}': expected name, form and parameters as class variables")
    for parameter in effect.parameters:
        _require_bounds(spec, parameter)
    if any(e.name == effect.name and e.form == effect.form for e in library()):
        raise GapError(
            f"effect '{spec}': the library already has {effect.name} ({effect.form}); choose another name or form"
        )


def _require_bounds(spec: str, parameter: EffectParameter) -> None:
    inside = [parameter.low <= start <= parameter.high for start in parameter.starts]
    if not parameter.low < parameter.high or not inside or not all(inside):
        raise GapError(
            f"effect '{spec}': {parameter.name} has bounds [{parameter.low:g}, {parameter.high:g}] and starts "
            f"{parameter.starts}; expected low < high and at least one start between them"
        )
