"""The pages of effects, from their classes (each form's documentation begins with its equation), and of structures."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from bench.reference.tables import code, codes, first_paragraph, paragraphs, span, table
from ces_gap.effects.effect import Effect, EffectParameter
from ces_gap.effects.library import library
from ces_identify.structures import KITS
from ces_observer.records import Record

ACTS_ON = ("sensors' readings", "motion", "current", "force of the oil", "force", "measured force")  # from SENSOR on
UNITS = (  # ends of parameters' names, the longest first
    ("_m_sN_per_J", "m/(s·N·J)"), ("_m_s_rtN", "m/(s·√N)"), ("_m_sN", "m/(s·N)"), ("_N_m2", "N/m²"), ("_N_m", "N/m"),
    ("_m_N", "m/N"), ("_m_s", "m/s"), ("_N_s", "N/s"), ("_s_m", "s/m"), ("_per_J", "1/J"), ("_per_K", "1/K"),
    ("_per_N", "1/N"), ("_kg", "kg"), ("_N", "N"), ("_m", "m"), ("_s", "s"), ("_A", "A"),
)  # fmt: skip
HEAD = """
What a damper, its mounting and its sensors do that a simulation may lack. `ces diagnose` fits every form around the
simulation, or inside its [twin](../diagnose.md#the-twin). F is the force inside an effect (the oil's, or that of
effects further in), an expression its force outside; x, v and i drive the simulation, which an effect may change to
x', v', i'. All are positive in compression. "Neutral" is without any effect. Searches keep to the usual range until a
fit ends at its bound; a value at a bound is flagged. `ces_gap/effects/library/NAME.py` names sources.
"""


def effects_page() -> str:
    """Return the page."""
    groups = [list(forms) for _, forms in groupby(library(), key=lambda effect: effect.name)]
    rows = [
        (f"[`{e.name}`](#{e.name})", e.summary, _acts_on(e), e.visible, codes(e.mistaken_for))
        for e in (forms[0] for forms in groups)
    ]
    overview = table(("effect", "what", "on", "visible", "mistaken for"), rows)
    return "\n".join(["# Effects", HEAD, overview, *map(_section, groups), ""])


def _acts_on(effect: Effect) -> str:
    return ACTS_ON[effect.stage]


def _section(forms: Sequence[Effect]) -> str:
    lines = [f"## `{forms[0].name}`\n"]
    described: set[type] = {Effect}
    for form in forms:
        for base in reversed(type(form).__mro__[1:-1]):
            if base not in described and paragraphs(base) and base.__module__ == type(form).__module__:
                lines.append(f"* {first_paragraph(base)}")
            described.add(base)
        described.add(type(form))
        lines.append(f"* `{form.form}`: {first_paragraph(type(form))}")
    by_parameter: dict[tuple[str, ...], list[str]] = {}
    for form in forms:
        for p in form.parameters:
            none = f"{p.neutral:g}".replace("inf", "∞") if p.magnitude else ""
            usual = span(*p.usual) if p.usual else ""
            by_parameter.setdefault((p.name, _bounds(p), usual, none, p.what), []).append(form.form)
    rows = [
        (f"`{name}`", "" if len(of) == len(forms) else codes(of), *described)
        for (name, *described), of in by_parameter.items()
    ]
    return "\n".join(lines) + "\n\n" + table(("parameter", "forms", "bounds", "usual", "neutral", "meaning"), rows)


def _bounds(parameter: EffectParameter) -> str:
    unit = next((f" {unit}" for end, unit in UNITS if parameter.name.endswith(end)), "")
    return f"{span(parameter.low, parameter.high)}{unit}"


STRUCTURES_HEAD = """
What `ces identify --structure NAME` fits; `auto` compares several. [Model structures](../structures.md) says
when to choose which, [why a model is stable](../proof.md) what is proved of each.
"""


def structures_page() -> str:
    """Return the page."""
    rows = [
        (
            code(name),
            kit.about,
            codes(size.flag for size in kit.sizes),
            codes(Record(kit.body).keys({})),
            "go on straight, up to a stated reach" if kit.body.extrapolates else "clamped",
        )
        for name, kit in KITS.items()
    ]
    sizes, keys = "[sizes](programs.md#identify)", "keys in `model.json`"
    heading = ("structure", "what it is", sizes, keys, "inputs outside the envelope")
    return "\n".join(["# Structures", STRUCTURES_HEAD, table(heading, rows)])
