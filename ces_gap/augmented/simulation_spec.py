"""The name of a simulation on the command line, converted for another folder: file paths become relative."""

from __future__ import annotations

import os
from pathlib import Path

from ces_identify.simulations.fmu_ports import SPEC

FILES = (".json", ".yaml", ".yml")


def file_of(spec: str) -> Path | None:
    """Return the file of a simulation; None for `topic:/name` and `module:function`."""
    path = _split(spec)[0]
    return None if path is None else Path(path)


def make_spec_relative(spec: str, folder: Path) -> str:
    """Return `spec` for a file in `folder`: its path relative to the folder where that is possible."""
    path, rest = _split(spec)
    if path is None:
        return spec
    try:
        return Path(os.path.relpath(Path(path).resolve(), folder.resolve())).as_posix() + rest
    except ValueError:  # another drive
        return str(Path(path).resolve()) + rest


def resolve_spec(spec: str, folder: Path) -> str:
    """Return a `spec` that is relative to `folder` as seen from the working directory."""
    path, rest = _split(spec)
    return spec if path is None else str(folder / path) + rest


def _split(spec: str) -> tuple[str | None, str]:
    """Return the path in `spec`, None if it has none, and the rest."""
    if spec.startswith("topic:"):
        return None, spec
    fmu = SPEC.fullmatch(spec)
    if fmu is not None:
        return fmu[1], spec[len(fmu[1]) :]
    return (spec, "") if Path(spec).suffix.lower() in FILES else (None, spec)
