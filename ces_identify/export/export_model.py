"""Export of a model for other programs: as C99 source, as a flat file that programs in C and C++ load, or as an FMU.

A checked `Model` goes in. The source is four texts: `ces_core.c` and `ces_core.h`, which `c_printer` prints from
`ces_observer.tick` and which are the same for every model, and a file of the model's numbers with its header
(templates/model.{c,h}.j2). Forces and reasons equal those of `ces_observer.estimator.Estimator`, bit for bit.

The flat file is little endian: MAGIC; the version and the length of the text, each 32 bits; the text, lines `key=value`
in UTF-8; zeros up to a multiple of 8. Then, for the sampling and the structure (`EstimatorArrays`): the sizes of p, n,
s and k, p as doubles, and n, all of 64 bits. Last the CRC-32 of all before it, 32 bits.

The FMU is FMI 2.0 co-simulation around the exported C, compiled and as source: a zip of modelDescription.xml, sources/
(complete, with BUILD.txt), and binaries/ for the compiler's platform. The same model gives the same sources, GUID and
zip layout. Source of the interface: FMI for Model Exchange and Co-Simulation 2.0, modelica.org.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import re
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
import textwrap
import uuid
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from math import ceil
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FunctionLoader, StrictUndefined

from ces_identify.export.c_printer import read_core
from ces_observer import __version__
from ces_observer.core import tick_digest
from ces_observer.errors import CesError, ModelError, OptionName
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
    facts = _flat_facts(model, name, certificate).items()
    text = "".join(f"{key}={' '.join(str(value).split())}\n" for key, value in facts).encode()
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


def _pack(part: Arrays) -> bytes:
    """Return the bytes of the arrays of a part; the state is new whenever it is loaded."""
    sizes = SIZES.pack(*map(len, part))
    return sizes + struct.pack(f"<{len(part.p)}d", *part.p) + struct.pack(f"<{len(part.n)}q", *part.n)


FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-fPIC", "-shared")
COMPILE_S = 300.0  # [s] time limit of a compiler
NEWTON = '<Real unit="N"/>'
EPOCH = (1980, 1, 1, 0, 0, 0)  # date of every file in the zip: the same model gives the same bytes


class Variable(NamedTuple):
    """A variable of the FMU; its place is its value reference. `kind` is the XML element of its type."""

    name: str
    kind: str
    description: str
    causality: str = "output"
    variability: str = "continuous"


def list_variables(model: Model) -> tuple[Variable, ...]:
    """Return the variables: reals, Booleans, and the reason; the force at once, or with the delay."""
    delay_s = model.sampling.delay_s
    reals = [
        Variable("position", '<Real unit="m" start="0.0"/>', "piston position, positive in compression", "input"),
        Variable("current", '<Real unit="A" start="0.0"/>', "valve current", "input"),
    ]
    if delay_s:
        what = f"damping force {delay_s:g} s ago, as it is known now, positive in compression; 0 unless valid"
        reals.append(Variable("force_delayed", NEWTON, what))
        what = "how long ago force_delayed was"
        reals.append(Variable("delay", f'<Real unit="s" start="{delay_s!r}"/>', what, "local", "constant"))
    else:
        reals.append(Variable("force", NEWTON, "damping force, positive in compression; 0 unless valid"))
    reals.append(Variable("speed", '<Real unit="m/s"/>', "speed as it is known at once"))
    booleans = (
        Variable("valid", "<Boolean/>", "the force may be used", variability="discrete"),
        Variable("clamped", "<Boolean/>", "inputs were outside the envelope of the model", variability="discrete"),
    )
    kind = '<Enumeration declaredType="Reason"/>'
    return (*reals, *booleans, Variable("reason", kind, "why the force is given or withheld", variability="discrete"))


def export_fmu(model: Model, name: str, certificate: Certificate, compiler: Sequence[str] = ()) -> bytes:
    """Return the bytes of NAME.fmu, with a binary for this machine if there is a `compiler`, else with sources only.

    `name` is the model identifier and the prefix of the C identifiers. Raises ModelError as `export_c` does, and
    CesError if the compiler fails.
    """
    files = {f"sources/{path}": text.encode("utf-8") for path, text in sources(model, name, certificate).items()}
    files["modelDescription.xml"] = render("fmi2.xml", _fmu_facts(model, name, certificate)).encode("utf-8")
    if compiler:
        files[binary_path(name)] = _compile_library(compiler, name, files)
    return _zip_files(files)


def sources(model: Model, name: str, certificate: Certificate) -> dict[str, str]:
    """Return the texts in the FMU's folder sources/ by file name."""
    if motion := model.sampling.motion:
        raise ModelError(
            f"the model needs the signal '{motion}', and an FMU has position and current only; "
            f"identify it with a signals file without '{motion}'"
        )
    facts = _fmu_facts(model, name, certificate)
    wrapper, build = render("fmi2.c", facts), render("fmi2_build.txt", facts)
    return {**export_c(model, name, name, certificate), f"fmi2_{name}.c": wrapper, "BUILD.txt": build}


def find_compiler() -> list[str]:
    """Return the C compiler's command, from CC or else cc, gcc or clang; raises CesError if there is none."""
    chosen = shlex.split(os.environ.get("CC", ""))
    for command in [chosen] if chosen else [["cc"], ["gcc"], ["clang"]]:
        if shutil.which(command[0]):
            return command
    problem = f"CC={chosen[0]} is not found" if chosen else "no C compiler found (cc, gcc or clang)"
    remedy = "; install one (sudo apt install gcc), or give ", OptionName("sources_only", True)
    raise CesError(problem, *remedy, " to write an FMU that is compiled elsewhere")


def binary_path(name: str) -> str:
    """Return the path of this machine's library in the FMU."""
    bits = "64" if sys.maxsize > 2**32 else "32"
    system, ending = {"win32": ("win", "dll"), "darwin": ("darwin", "dylib")}.get(sys.platform, ("linux", "so"))
    return f"binaries/{system}{bits}/{name}.{ending}"


def _fmu_facts(model: Model, name: str, certificate: Certificate) -> dict[str, object]:
    digest, variables = model.digest(), list_variables(model)
    kind = f"ces_observer {__version__} {name} {digest} {certificate.to_mapping()}".encode()
    promise = (
        f"stable for every input (proved), in a tick {certificate.force_claim}"
        if certificate.holds
        else "STABILITY NOT PROVED, not for a vehicle"
    )
    return {
        "name": name,
        "NAME": name.upper(),
        "version": __version__,
        "digest": digest,
        "guid": "{" + str(uuid.UUID(bytes=hashlib.sha256(kind).digest()[:16])) + "}",
        "model": model,
        "promise": promise,
        "reasons": CODES,
        "variables": variables,
        "reals": sum(variable.kind.startswith("<Real") for variable in variables),
        "delay_s": model.sampling.delay_s,
        "max_known_ns": round(1e9 * (model.sampling.delay_s + model.sampling.max_gap_s)),
        "command": " ".join(["cc", *_arguments(name, f"{name}.so")]),
    }


def _arguments(name: str, out: str) -> list[str]:
    return [*FLAGS, "-o", out, f"{name}.c", CORE[0], f"fmi2_{name}.c", "-lm"]


def _compile_library(compiler: Sequence[str], name: str, files: Mapping[str, bytes]) -> bytes:
    """Return the shared library compiled from the sources."""
    with tempfile.TemporaryDirectory(prefix="ces_fmu_") as folder:
        for path, content in files.items():
            if path.startswith("sources/"):
                (Path(folder) / Path(path).name).write_bytes(content)
        command = [*compiler, *_arguments(name, "library")]
        remedy = "; name another in CC, or give ", OptionName("sources_only", True)
        try:
            run = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=COMPILE_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CesError(f"{command[0]}: cannot compile ({error})", *remedy) from None
        if run.returncode:
            message = next((line for line in run.stderr.splitlines() if "error" in line), f"status {run.returncode}")
            raise CesError(f"{command[0]}: {message} ({platform.machine()})", *remedy)
        return (Path(folder) / "library").read_bytes()


def _zip_files(files: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(files):
            entry = zipfile.ZipInfo(path, EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if path.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, files[path])
    return buffer.getvalue()
