"""Export of a model as an FMU: FMI 2.0 co-simulation around the exported C, compiled and as source.

A checked `Model` goes in, the bytes of a zip come out: modelDescription.xml, sources/ (complete, with BUILD.txt), and
binaries/ for the compiler's platform. The same model gives the same sources, GUID and zip layout. Source of the
interface: FMI for Model Exchange and Co-Simulation 2.0, modelica.org.
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
from pathlib import Path
from typing import NamedTuple

from ces_identify.export.export_c import CODES, CORE, export_c, render
from ces_observer import __version__
from ces_observer.errors import CesError, ModelError
from ces_observer.model import Model
from ces_observer.proof.certificate import Certificate

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
    files["modelDescription.xml"] = render("fmi2.xml", _facts(model, name, certificate)).encode("utf-8")
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
    facts = _facts(model, name, certificate)
    wrapper, build = render("fmi2.c", facts), render("fmi2_build.txt", facts)
    return {**export_c(model, name, name, certificate), f"fmi2_{name}.c": wrapper, "BUILD.txt": build}


def find_compiler() -> list[str]:
    """Return the C compiler's command, from CC or else cc, gcc or clang; raises CesError if there is none."""
    chosen = shlex.split(os.environ.get("CC", ""))
    for command in [chosen] if chosen else [["cc"], ["gcc"], ["clang"]]:
        if shutil.which(command[0]):
            return command
    problem = f"CC={chosen[0]} is not found" if chosen else "no C compiler found (cc, gcc or clang)"
    remedy = "install one (sudo apt install gcc), or give --sources-only to write an FMU that is compiled elsewhere"
    raise CesError(f"{problem}; {remedy}")


def binary_path(name: str) -> str:
    """Return the path of this machine's library in the FMU."""
    bits = "64" if sys.maxsize > 2**32 else "32"
    system, ending = {"win32": ("win", "dll"), "darwin": ("darwin", "dylib")}.get(sys.platform, ("linux", "so"))
    return f"binaries/{system}{bits}/{name}.{ending}"


def _facts(model: Model, name: str, certificate: Certificate) -> dict[str, object]:
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
        remedy = "name another in CC, or give --sources-only"
        try:
            run = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=COMPILE_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CesError(f"{command[0]}: cannot compile ({error}); {remedy}") from None
        if run.returncode:
            message = next((line for line in run.stderr.splitlines() if "error" in line), f"status {run.returncode}")
            raise CesError(f"{command[0]}: {message} ({platform.machine()}); {remedy}")
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
