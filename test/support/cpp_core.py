"""The core of the C++ package, compiled without ROS: the program `replay`, and flat files of models."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from ces_identify.export.cpp_sources import write_sources
from ces_identify.export.export_model import write_flat
from ces_observer.model import Model
from ces_observer.proof.certificate import Contraction

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "ces_observer_cpp"
REPLAY = ROOT / "test" / "ces_observer_cpp" / "replay.cpp"
WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
FLAGS = [*WARNINGS, "-ffp-contract=off", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined"]
HOLDS, UNPROVED = Contraction(0.5, 1.0, 1, "", ""), Contraction(2.0, 1.0, 1, "", "")


def compile_replay(folder: Path) -> Path:
    """Compile the program in a folder; return its path."""
    write_sources(folder)
    program, core = folder / "replay", folder / "ces_core.o"
    sources = [REPLAY, PACKAGE / "src" / "model" / "flat_file.cpp", core]
    includes = [f"-I{PACKAGE / 'src'}", f"-I{folder}"]
    subprocess.run(["cc", "-std=c99", *FLAGS, "-c", folder / "ces_core.c", "-o", core], check=True)
    subprocess.run(["c++", "-std=c++17", *FLAGS, *includes, *sources, "-o", program], check=True)
    return program


def save_flat(model: Model, path: Path, certificate: Contraction = HOLDS) -> Path:
    """Write the flat file of a model; return its path."""
    path.write_bytes(write_flat(model, path.stem, certificate))
    return path


def run(words: Sequence[str | Path]) -> tuple[int, str]:
    """Run a program; return exit status and output."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr
