"""Export of a model for programs in C: as C99 source for a microcontroller, or as a flat file that is loaded.

A checked `Model` goes in. The source is four texts: `ces_core.c` and `ces_core.h`, which `c_printer` prints from
`ces_observer.tick` and which are the same for every model, and a file of the model's numbers with its header
(templates/model.{c,h}.j2). Forces and reasons equal those of `ces_observer.estimator.Estimator`, bit for bit.

The flat file is little endian: MAGIC; the version and the length of the text, each 32 bits; the text, lines `key=value`
in UTF-8; zeros up to a multiple of 8. Then, for the sampling and the structure (`EstimatorArrays`): the sizes of p, n,
s and k, p as doubles, and n, all of 64 bits. Last the CRC-32 of all before it, 32 bits.
"""

from __future__ import annotations

import re
import struct
import textwrap
import zlib
from collections.abc import Iterable, Mapping
from importlib import resources
from math import ceil

from jinja2 import Environment, FunctionLoader, StrictUndefined

from ces_identify.export.c_printer import read_core
from ces_observer import __version__
from ces_observer.core import tick_digest
from ces_observer.errors import ModelError
from ces_observer.estimator import EstimatorArrays, lay_out_estimator
from ces_observer.flat import Arrays
from ces_observer.model import Model
from ces_observer.proof.certificate import Certificate
from ces_observer.reasons import REASONS
from ces_observer.tick import tracker
from ces_observer.tick.estimator import check_model

CODES: Mapping[str, tuple[int, str]] = {
    name: (getattr(tracker, name), REASONS[getattr(tracker, name)])
    for name in ("OK", "WARMING_UP", "NOT_FINITE", "OUT_OF_ORDER", "OUTLIER", "UNBOUNDED", "BEYOND_STROKE")
}
CORE = ("ces_core.c", "ces_core.h")
USED = ("structure_reset", "structure_tick", "estimator_reset", "estimator_step", "run_half_width")  # of the core
LONGEST_NAME = 31  # significant characters of an external identifier in C99
NAME_ENDING = "_past_reset"  # the longest that is added to a name
STANDARD_HEADERS = ("float", "math", "stdbool", "stddef", "stdint", "ces_core")
UNITS = {"speed": "m/s", "acceleration": "m/s2"}  # of a measured motion
WIDTH = 116  # of a comment or table


def export_c(model: Model, name: str, file_stem: str, certificate: Certificate) -> dict[str, str]:
    """Return the texts of FILE_STEM.c, FILE_STEM.h and of the core by file name; identifiers begin with `name`.

    Comments state the `certificate`. Raises ModelError if the model cannot be used or a name is not usable.
    """
    require_usable_names(name, file_stem)
    arrays = lay_out_estimator(model)
    require_within(arrays, name)
    facts = _facts(model, name, file_stem, certificate, arrays)
    texts = {f"{file_stem}.{kind}": render(f"model.{kind}", facts) for kind in "ch"}
    core = read_core(USED)
    return {**texts, **dict(zip(CORE, (core.source, core.header), strict=True))}


def require_usable_names(name: str, file_stem: str) -> None:
    """Raise ModelError unless C can have these names of identifiers and of a file."""
    if identifier(name) != name.lower() or not name.isascii():
        raise ModelError(f"name '{name}': not usable in C; choose one such as '{identifier(name)}'")
    if name.lower() == "ces":
        raise ModelError(f"name '{name}': is the core's; choose another")
    if not re.fullmatch(r"[0-9A-Za-z][0-9A-Za-z_.-]*", file_stem) or file_stem in STANDARD_HEADERS:
        raise ModelError(
            f"file name '{file_stem}.c': choose letters, digits and _, and not a standard header or the core"
        )


def identifier(text: str) -> str:
    """Return `text` as the beginning of C identifiers: `my-damper 2` becomes `my_damper_2`."""
    name = re.sub(r"[^0-9A-Za-z]+", "_", text).strip("_").lower()
    name = f"model_{name}" if not name or name[0].isdigit() else name
    return name[: LONGEST_NAME - len(NAME_ENDING)].rstrip("_")


def _facts(
    model: Model, name: str, file_stem: str, certificate: Certificate, arrays: EstimatorArrays
) -> dict[str, object]:
    sampling, parts = model.sampling, arrays._asdict()
    tables = [
        _table(f"static const {kind} {part.upper()}_{array.upper()}", getattr(of, array))
        for part, of in parts.items()
        for kind, array in (("double", "p"), ("int64_t", "n"))
    ]
    unit = UNITS.get(sampling.motion, "")
    return {
        "name": name,
        "NAME": name.upper(),
        "stem": file_stem,
        "version": __version__,
        "digest": model.digest(),
        "core_digest": tick_digest(),
        "model": model,
        "proof": _proof(certificate),
        "noun": model.body.name.replace("_", " "),
        "reasons": CODES,
        "sizes": {part: (len(of.s), len(of.k)) for part, of in parts.items()},
        "tables": tables,
        "has_width": not sampling.delay_ticks and model.band is not None,
        "delay": sampling.delay_ticks,
        "motion": sampling.motion,
        "unit": unit,
        "measured": f"{sampling.motion}_{unit.replace('/', '_')}",
        "most_ticks": ceil(sampling.max_gap_s * sampling.rate_Hz) + 1,
    }


def _proof(certificate: Certificate) -> list[str]:
    """Return the lines that state what is proved, with bounds that are not rounded."""
    if not certificate.holds:
        return _wrap(f"Stability: NOT PROVED ({certificate.doubt}). Not for a vehicle.")
    bounds = ", ".join(f"{key} {value!r}" for key, value in certificate.bounds.items())
    return [
        *_wrap(f"Stability: proved at export. {certificate.claim}. {certificate.effort}."),
        *_wrap(f"Bounds: {bounds}."),
    ]


def _wrap(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


def _table(name: str, values: Iterable[float]) -> str:
    """Return the definition of a constant array in C, whose numbers read back exactly."""
    numbers = [repr(value) for value in values]
    text = textwrap.fill(", ".join(numbers), WIDTH, break_long_words=False, break_on_hyphens=False)
    return f"{name}[{len(numbers)}] = {{\n{textwrap.indent(text, '    ')}\n}};"


def render(template: str, facts: Mapping[str, object]) -> str:
    """Return the text of the template TEMPLATE.j2 in templates/."""
    folder = resources.files("ces_identify.export") / "templates"
    environment = Environment(
        loader=FunctionLoader(lambda name: (folder / f"{name}.j2").read_text(encoding="utf-8")),
        autoescape=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(facts)


MAGIC = b"CES-FLAT"
VERSION = 2
HEAD = struct.Struct("<8sII")
SIZES = struct.Struct("<4q")
CHECKSUM = struct.Struct("<I")


def write_flat(model: Model, name: str, certificate: Certificate) -> bytes:
    """Return the bytes of the flat file. Raises ModelError if the tick would not stay within the model's arrays."""
    arrays = lay_out_estimator(model)
    require_within(arrays, name)
    text = "".join(
        f"{key}={_as_line(value)}\n" for key, value in _flat_facts(model, name, certificate).items()
    ).encode()
    content = HEAD.pack(MAGIC, VERSION, len(text)) + text
    content += bytes(-len(content) % 8) + b"".join(map(_pack, arrays))
    return content + CHECKSUM.pack(zlib.crc32(content))


def require_within(arrays: EstimatorArrays, source: str) -> None:
    """Raise ModelError unless the tick stays within all arrays, whatever its samples are."""
    sizes = [[part.p, part.n, *map(len, part)] for part in arrays]
    if not check_model(*(value for part in sizes for value in part)):  # type: ignore[arg-type]
        raise ModelError(f"{source}: its arrays are not those of a model; identify the model again")


def _flat_facts(model: Model, name: str, certificate: Certificate) -> dict[str, object]:
    """Return what a program shows of the model, and needs beside the arrays."""
    sampling = model.sampling
    return {
        "core": tick_digest(),
        "model": model.digest(),
        "name": name,
        "size": model.size,
        "outside": model.body.outside,
        "extrapolates": int(model.body.extrapolates),
        "motion": sampling.motion,
        "rate_Hz": sampling.rate_Hz,
        "stroke_min_m": sampling.stroke_m[0],
        "stroke_max_m": sampling.stroke_m[1],
        "delay_s": sampling.delay_s,
        "max_gap_s": sampling.max_gap_s,
        "max_current_age_s": sampling.max_current_age_s,
        "proved": int(certificate.holds),
        "force_bound_N": certificate.force_N,
        "claim": certificate.claim,
        "version": __version__,
    }


def _as_line(value: object) -> str:
    return " ".join(str(value).split())


def _pack(part: Arrays) -> bytes:
    """Return the bytes of the arrays of a part; the state is new whenever it is loaded."""
    sizes = SIZES.pack(*map(len, part))
    return sizes + struct.pack(f"<{len(part.p)}d", *part.p) + struct.pack(f"<{len(part.n)}q", *part.n)
