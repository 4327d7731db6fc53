"""Export of a model as a self-contained C99 source file and header: the estimator for a microcontroller.

A checked `Model` goes in, two texts come out. They do what `ces_observer.estimator.Estimator` does, operation by
operation, so that forces and reasons agree; a tick that solves an equation may do so by another method, as its solution
is unique. templates/estimator.{c,h}.j2 hold the C around the tick of a structure, which its kit describes. Only numbers
of the model reach the texts. Templates are filled by `render`, also for the FMU and the ROS 2 package.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources
from math import ceil, exp, pi, sqrt
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined

from ces_identify.structures import KITS, kit_of
from ces_identify.structures.kit import CTick, constructed_variable, number
from ces_observer import __version__, estimator, tracker
from ces_observer.adaptive_differentiator import MAX_SQUARE, MEMORY_S, NOISE_SHARE, SHARES
from ces_observer.band import Band
from ces_observer.errors import ModelError
from ces_observer.model import ADAPTIVE, FUSED, Model, Sampling
from ces_observer.proof.certificate import Certificate

REASONS: Mapping[str, str] = {
    "OK": tracker.OK,
    "WARMING_UP": estimator.WARMING_UP,
    "NOT_FINITE": tracker.NOT_FINITE,
    "OUT_OF_ORDER": tracker.OUT_OF_ORDER,
    "OUTLIER": tracker.OUTLIER,
    "UNBOUNDED": estimator.UNBOUNDED,
}
LONGEST_NAME = 31  # significant characters of an external identifier in C99
NAME_ENDING = "_past_reset"  # the longest that is added to a name
STANDARD_HEADERS = ("float", "math", "stdbool", "stdint")


def export_c(model: Model, name: str, file_stem: str, certificate: Certificate) -> tuple[str, str]:
    """Return the texts of FILE_STEM.c and FILE_STEM.h, whose identifiers begin with `name`.

    Comments state the `certificate`. Raises ModelError if the model cannot be written in C or a name is not usable.
    """
    tick = require_exportable(model, name, file_stem)
    facts = {
        "name": name,
        "NAME": name.upper(),
        "source_file": f"{file_stem}.c",
        "header_file": f"{file_stem}.h",
        "version": __version__,
        "digest": model.digest(),
        "certificate": certificate,
        "model": model,
        "reasons": REASONS,
        "tick": tick.template,
        "noun": tick.noun,
        "constants": {},
        "band": _band(model.band, model.sampling.rate_Hz),
        **_sampling(model),
        **tick.facts(model.body, model),
    }
    return render("estimator.c", facts), render("estimator.h", facts)


def require_exportable(model: Model, name: str, file_stem: str) -> CTick[Any]:
    """Return how the model's tick is written; raises ModelError if `export_c` cannot write it with these names."""
    tick = kit_of(model.body).c_tick
    if tick is None:
        known = ", ".join(kit.body.name for kit in KITS.values() if kit.c_tick)
        raise ModelError(f"structure is {model.structure}; only {known} can be written in C")
    if identifier(name) != name.lower() or not name.isascii():
        raise ModelError(f"name '{name}': not usable in C; choose one such as '{identifier(name)}'")
    if not re.fullmatch(r"[0-9A-Za-z][0-9A-Za-z_.-]*", file_stem) or file_stem in STANDARD_HEADERS:
        raise ModelError(f"file name '{file_stem}.c': choose letters, digits and _, and not a standard header")
    return tick


def identifier(text: str) -> str:
    """Return `text` as the beginning of C identifiers: `my-damper 2` becomes `my_damper_2`."""
    name = re.sub(r"[^0-9A-Za-z]+", "_", text).strip("_").lower()
    name = f"model_{name}" if not name or name[0].isdigit() else name
    return name[: LONGEST_NAME - len(NAME_ENDING)].rstrip("_")


def _sampling(model: Model) -> dict[str, object]:
    """Return the constants of the tracker, computed as the tracker and its differentiator compute them."""
    s = model.sampling
    damping = 0.5 if s.order == 3 else sqrt(0.5)
    settling_s = tracker.SETTLING / (2.0 * pi * s.bandwidth_Hz)
    return {
        "order": s.order,
        "motion": s.motion_signal,
        "unit": {"speed": "m_s", "acceleration": "m_s2"}.get(s.motion_signal, ""),
        "coasts": s.order == 3 and s.differentiator != FUSED,
        **(_filters(s) if s.differentiator == ADAPTIVE else {"adaptive": False}),
        "ticks_per_ns": s.rate_Hz * 1e-9,
        "max_gap_s": s.max_gap_s,
        "max_gap_ns": round(s.max_gap_s * 1e9),
        "most_ticks": ceil(s.max_gap_s * s.rate_Hz) + 1,
        "patience": tracker.PATIENCE,
        "overdue_s": tracker.OVERDUE / s.rate_Hz,
        "settling_s": settling_s,
        "settling_ticks": settling_s * s.rate_Hz,
        "doubt_s": tracker.DOUBT * settling_s,
        "doubt_ticks": tracker.DOUBT * (settling_s * s.rate_Hz),
        "largest_change_m_s": tracker.LARGEST_CHANGE * 2.0 * pi * s.bandwidth_Hz * s.outlier_m,
        "warm_up_ticks": round(s.warm_up_s * s.rate_Hz),
        "decay": -damping * 2.0 * pi * s.bandwidth_Hz,
        "turn": sqrt(1.0 - damping * damping) * 2.0 * pi * s.bandwidth_Hz,
    }


def _filters(s: Sampling) -> dict[str, object]:
    """Return the constants of the adaptive differentiator's filters."""
    damping = 0.5 if s.order == 3 else sqrt(0.5)
    turn = sqrt(1.0 - damping * damping) * 2.0 * pi
    return {
        "adaptive": True,
        "shares": SHARES,
        "memory_s": MEMORY_S,
        "variance": NOISE_SHARE * s.noise_m * s.noise_m,
        "max_square": MAX_SQUARE,
        "decays": [-damping * 2.0 * pi * (share * s.bandwidth_Hz) for share in SHARES],
        "turns": [turn * (share * s.bandwidth_Hz) for share in SHARES],
    }


def _band(band: Band | None, rate_Hz: float) -> dict[str, object] | None:
    """Return the values for the templates, computed as `ces_observer.band.BandRun` computes them; None without one."""
    if band is None:
        return None
    span = band.current_A[1] - band.current_A[0]
    return {
        "level": band.level,
        "gain": 1.0 - exp(-1.0 / (band.change_s * rate_Hz)),
        "fade": exp(-1.0 / (band.reversal_s * rate_Hz)),
        "speed_m_s": band.speed_m_s,
        "low_A": band.current_A[0],
        "per_A": 1.0 / span if span > 0.0 else 0.0,
        "parts": band.parts,
        "mean": band.mean,
        "whitening": band.whitening,
        "limit": band.max_distance * band.max_distance,
        "share": band.constant_share,
        "rest": 1.0 - band.constant_share,
    }


def render(template: str, facts: Mapping[str, object]) -> str:
    """Return the text of the template TEMPLATE.j2."""
    return _make_environment().get_template(template).render(facts)


def render_text(template: str, facts: Mapping[str, object]) -> str:
    """Return the text that the text of a template gives."""
    return _make_environment().from_string(template).render(facts)


def _make_environment() -> Environment:
    """Return the templates: those of structures lie beside their modules, all others in templates/."""
    beside = resources.files("ces_identify.structures")
    general = resources.files("ces_identify.export") / "templates"

    def load(name: str) -> str:
        path = beside / f"{name}.j2"
        return (path if path.is_file() else general / f"{name}.j2").read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(load),
        autoescape=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(number=number, text=text_literal, variable=constructed_variable)
    return environment


def text_literal(text: str) -> str:
    """Return a string literal that C, C++ and YAML read alike. Raises ModelError for what cannot be printed."""
    if not text.isprintable():
        raise ModelError(f"{text!r}: expected printable characters")
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
