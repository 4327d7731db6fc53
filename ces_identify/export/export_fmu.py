"""A model as an FMU: FMI 2.0 co-simulation, the exported C estimator with a thin wrapper, compiled and as source.

A checked `Model` goes in, the bytes of a zip come out: modelDescription.xml, sources/ (complete, with BUILD.txt), and
binaries/ for the platform of the compiler that was given. The same model gives the same sources, GUID and zip layout.
Source of the interface: FMI for Model Exchange and Co-Simulation 2.0, modelica.org.
"""

from __future__ import annotations

import hashlib
import io
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from ces_identify.export.c_text import number
from ces_identify.export.export_c import REASONS, export_c
from ces_observer import __version__
from ces_observer.errors import CesError
from ces_observer.model import Model
from ces_observer.proof.certificate import Certificate

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-fPIC", "-shared")
COMPILE_S = 300.0  # [s] after which a compiler is taken to hang
EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file in the zip, so that the same model gives the same bytes


@dataclass(frozen=True)
class Variable:
    """A variable of the FMU; its place in VARIABLES is its value reference. `kind` is its type's XML element."""

    name: str
    causality: str
    variability: str
    kind: str
    description: str


VARIABLES = (
    Variable(
        "position", "input", "continuous", '<Real unit="m" start="0.0"/>', "piston position, positive in compression"
    ),
    Variable("current", "input", "continuous", '<Real unit="A" start="0.0"/>', "valve current"),
    Variable(
        "force", "output", "continuous", '<Real unit="N"/>', "damping force, positive in compression; 0 unless valid"
    ),
    Variable("speed", "output", "continuous", '<Real unit="m/s"/>', "speed that the model used"),
    Variable("valid", "output", "discrete", "<Boolean/>", "the force may be used"),
    Variable("clamped", "output", "discrete", "<Boolean/>", "inputs lay outside what the model was identified on"),
    Variable(
        "reason", "output", "discrete", '<Enumeration declaredType="Reason"/>', "why the force is given or withheld"
    ),
)


def export_fmu(model: Model, name: str, certificate: Certificate, compiler: Sequence[str] = ()) -> bytes:
    """Return the bytes of NAME.fmu, with a binary for this machine if a `compiler` is given, else sources only.

    `name` is the model identifier and begins every C identifier. Raises ModelError as `export_c` does, and CesError
    if the compiler fails.
    """
    files = {f"sources/{path}": text.encode("utf-8") for path, text in sources(model, name, certificate).items()}
    files["modelDescription.xml"] = _render("fmi2.xml", _facts(model, name, certificate)).encode("utf-8")
    if compiler:
        files[binary_path(name)] = _compile_library(compiler, name, files)
    return _zip_files(files)


def sources(model: Model, name: str, certificate: Certificate) -> dict[str, str]:
    """Return the texts of the FMU's folder sources/ by file name."""
    source, header = export_c(model, name, name, certificate)
    facts = _facts(model, name, certificate)
    wrapper, build = _render("fmi2.c", facts), _render("fmi2_build.txt", facts)
    return {f"{name}.c": source, f"{name}.h": header, f"fmi2_{name}.c": wrapper, "BUILD.txt": build}


def find_compiler() -> list[str]:
    """Return the C compiler's command: that in the environment variable CC, or the first of cc, gcc and clang.

    Raises CesError if there is none.
    """
    given = shlex.split(os.environ.get("CC", ""))
    for command in [given] if given else [["cc"], ["gcc"], ["clang"]]:
        if shutil.which(command[0]):
            return command
    told = f"CC={given[0]} is not found" if given else "no C compiler found (cc, gcc or clang)"
    raise CesError(f"{told}; install one, or give --sources-only to write an FMU that is compiled elsewhere")


def binary_path(name: str) -> str:
    """Return where in the FMU this machine's library lies."""
    bits = "64" if sys.maxsize > 2**32 else "32"
    system, ending = {"win32": ("win", "dll"), "darwin": ("darwin", "dylib")}.get(sys.platform, ("linux", "so"))
    return f"binaries/{system}{bits}/{name}.{ending}"


def _facts(model: Model, name: str, certificate: Certificate) -> dict[str, object]:
    digest = model.digest()
    kind = f"ces_observer {__version__} {name} {digest} {certificate.to_mapping()}".encode()
    promise = (
        f"stable for every input (proved), force of a tick within {certificate.force_N:.0f} N"
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
        "reasons": REASONS,
        "variables": VARIABLES,
        "command": " ".join(["cc", *_arguments(name, f"{name}.so")]),
    }


def _render(kind: str, facts: Mapping[str, object]) -> str:
    environment = Environment(
        autoescape=False, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters["number"] = number
    template = (resources.files("ces_identify.export") / "templates" / f"{kind}.j2").read_text(encoding="utf-8")
    return environment.from_string(template).render(facts)


def _arguments(name: str, out: str) -> list[str]:
    return [*FLAGS, "-o", out, f"{name}.c", f"fmi2_{name}.c", "-lm"]


def _compile_library(compiler: Sequence[str], name: str, files: Mapping[str, bytes]) -> bytes:
    """Return the shared library that `compiler` makes of the sources."""
    with tempfile.TemporaryDirectory(prefix="ces_fmu_") as folder:
        for path, content in files.items():
            if path.startswith("sources/"):
                (Path(folder) / Path(path).name).write_bytes(content)
        _run([*compiler, *_arguments(name, "library")], folder)
        return (Path(folder) / "library").read_bytes()


def _run(command: Sequence[str], folder: str) -> None:
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=COMPILE_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CesError(f"{command[0]}: cannot compile ({error}); name another in CC, or give --sources-only") from None
    if done.returncode:
        said = next((line for line in done.stderr.splitlines() if "error" in line), f"status {done.returncode}")
        raise CesError(f"{command[0]}: {said} ({platform.machine()}); name another in CC, or give --sources-only")


def _zip_files(files: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(files):
            entry = zipfile.ZipInfo(path, EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if path.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, files[path])
    return buffer.getvalue()
