"""Export of a model as a self-contained C99 source file and header: the estimator for a microcontroller.

A checked `Model` goes in, two texts come out. They do what `ces_observer.estimator.Estimator` does, operation by
operation, so that forces and reasons agree; a tick that solves an equation may do so by another method, as its solution
is unique. templates/run.{c,h}.j2 hold the C around the tick of a structure, which its kit describes, for each model of
the file; speed_bank.c.j2, late.c.j2 and estimator.{c,h}.j2 hold the rest. Only numbers of the model reach the texts.
Templates are filled by `render`, also for the FMU and the ROS 2 package.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources
from math import ceil, exp
from typing import Any

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined

from ces_data.arrays import F
from ces_identify.numerics.speed_kernels import make_bank
from ces_identify.structures import KITS, kit_of
from ces_identify.structures.kit import ConstantTable, CTick, constructed_variable, number
from ces_observer import __version__, estimator, tracker
from ces_observer.band import Band
from ces_observer.bank_design import BINS, EARLIEST, SHIFTS
from ces_observer.errors import ModelError
from ces_observer.model import Model, Sampling
from ces_observer.proof.certificate import Certificate
from ces_observer.speed_bank import LOST, SpeedBank

REASONS: Mapping[str, str] = {
    "OK": tracker.OK,
    "WARMING_UP": estimator.WARMING_UP,
    "NOT_FINITE": tracker.NOT_FINITE,
    "OUT_OF_ORDER": tracker.OUT_OF_ORDER,
    "OUTLIER": tracker.OUTLIER,
    "UNBOUNDED": estimator.UNBOUNDED,
    "BEYOND_STROKE": tracker.BEYOND_STROKE,
}
LONGEST_NAME = 31  # significant characters of an external identifier in C99
NAME_ENDING = "_past_reset"  # the longest that is added to a name
STANDARD_HEADERS = ("float", "math", "stdbool", "stdint")
DELAYED = "delayed_"  # begins names of the delayed model beside one without a delay
AT_FILE_SCOPE = re.compile(
    r"^(?:#define (\w+)|(?:static|enum|void|double)\b[^;=(\[]*?(\w+)(?= ?[(\[=])|\} (\w+);)", re.MULTILINE
)  # names that a C text defines
PUBLIC = re.compile(r"^(?=(?:enum|void|double)\b)", re.MULTILINE)  # where a function with external linkage begins


def export_c(model: Model, name: str, file_stem: str, certificate: Certificate) -> tuple[str, str]:
    """Return the texts of FILE_STEM.c and FILE_STEM.h, whose identifiers begin with `name`.

    Comments state the `certificate`, which holds only if that of a second, delayed model does, too. Raises ModelError
    if the model cannot be written in C or a name is not usable.
    """
    tick = require_exportable(model, name, file_stem)
    sources, headers = zip(*_runs(model, name), strict=True)
    facts = {
        "source_file": f"{file_stem}.c",
        "header_file": f"{file_stem}.h",
        "version": __version__,
        "digest": model.digest(),
        "certificate": certificate,
        "reasons": REASONS,
        "now": not model.sampling.delay_ticks,
        "delayed_band": model.best.band is not None,
        "prefix": DELAYED if model.delayed else "",
        **_run_facts(model, name, tick),
        **_sampling(model),
        **_bank(model.best.sampling),
    }
    return render("estimator.c", facts | {"runs": sources}), render("estimator.h", facts | {"runs": headers})


def _runs(model: Model, name: str) -> list[tuple[str, str]]:
    """Return the C of each model's tick with its band and warm-up, and what the header has of it."""
    facts = [_run_facts(one, name, require_exportable(one, name, name)) for one in model.each]
    first, *others = [(render("run.c", one), render("run.h", one)) for one in facts]
    return [first, *(_rename(*texts, name) for texts in others)]


def _rename(source: str, header: str, name: str) -> tuple[str, str]:
    """Return the same C with other names for all that it defines, and without public functions."""
    names = {one for found in AT_FILE_SCOPE.findall(source + header) for one in found if one}

    def renamed(found: re.Match[str]) -> str:
        word = found[0]
        public = f"{name}_" if word.startswith(f"{name}_") else ""
        new = public + (DELAYED.upper() if word.isupper() else DELAYED) + word.removeprefix(public)
        return new if word in names else word

    return PUBLIC.sub("static ", re.sub(r"\w+", renamed, source)), re.sub(r"\w+", renamed, header)


def _run_facts(model: Model, name: str, tick: CTick[Any]) -> dict[str, object]:
    """Return what the templates of a model's tick need."""
    return {
        "name": name,
        "NAME": name.upper(),
        "model": model,
        "tick": tick.template,
        "noun": tick.noun,
        "constants": {},
        "band": _band(model.band, model.sampling.rate_Hz),
        **tick.facts(model.body, model),
    }


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
    """Return the constants of the tracker, computed as the tracker computes them."""
    s = model.sampling
    settling_s = tracker.SETTLING * SpeedBank(s.stroke).response_s
    settling_ticks = settling_s * s.rate_Hz
    return {
        "motion": s.motion,
        "max_motion": tracker.MAX_MOTION,
        "unit": {"speed": "m_s", "acceleration": "m_s2"}.get(s.motion, ""),
        "ticks_per_ns": s.rate_Hz * 1e-9,
        "max_gap_s": s.max_gap_s,
        "max_gap_ns": round(s.max_gap_s * 1e9),
        "most_ticks": ceil(s.max_gap_s * s.rate_Hz) + 1,
        "patience": tracker.PATIENCE,
        "overdue_s": tracker.OVERDUE / s.rate_Hz,
        "settling_s": settling_s,
        "settling_ticks": settling_ticks,
        "doubt_s": tracker.DOUBT * settling_s,
        "doubt_ticks": tracker.DOUBT * settling_ticks,
        "largest_change_m_s": tracker.MAX_CHANGE * s.speed_m_s,
        "warm_up_ticks": round(s.warm_up_s * s.rate_Hz),
    }


def _bank(sampling: Sampling) -> dict[str, object]:
    """Return the constants of the speed bank; without a measured motion, without what belongs to its innovation."""
    bank = make_bank(sampling)
    pairs, likelihoods, weights = slice(0, 16), slice(16, 20), slice(20, 28)
    smoothing, modes = bank.smoothing, len(bank.moves)
    if not sampling.motion:
        pairs, likelihoods, weights, smoothing = slice(0, 14, 2), slice(16, 20, 3), slice(20, 24), smoothing[:, :1]
    late = EARLIEST - BINS // 2  # the first time of a sample that begins a tick
    gains = [bank.gains[0], *bank.gains[1:, late:]]
    return {
        "delay": sampling.delay_ticks,
        "modes": modes,
        "spans": bank.spans.tolist(),
        "bins": BINS,
        "earliest": EARLIEST,
        "late_bins": len(SHIFTS) - late,
        "tick_s": bank.tick_s,
        "stay": bank.stay,
        "leave": bank.leave,
        "lost": LOST,
        "moves": _rows("BANK_MOVES", bank.moves),
        "weights": _rows("BANK_WEIGHTS", bank.gains[0, ..., weights]),
        "gains": _rows("BANK_GAINS", np.concatenate(gains)[..., pairs]),
        "likelihoods": _rows("BANK_LIKELIHOODS", bank.gains[:, 0, :, likelihoods]),
        "smoothing": _rows("SMOOTHING", smoothing.reshape(modes, -1)),
    }


def _rows(name: str, rows: F) -> ConstantTable:
    return ConstantTable(name, rows.ravel().tolist(), rows.shape[-1])


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
