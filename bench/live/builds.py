"""Builds the C++ programs: the generator and the empty relay, and the C++ twin of a model's observer."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
FOLDER = ROOT / "out" / "live"  # kept, so that a second run builds only what has changed
TWIN = "bench_twin"


class BuildError(Exception):
    """A program that cannot be built, in one line."""


def build_programs() -> Path:
    """Build generator and relay; return their folder. Raises BuildError."""
    folder = FOLDER / "programs"
    for tool in ("cmake", "c++"):
        if shutil.which(tool) is None:
            raise BuildError(f"{tool} is missing; the generator and the relay are in C++")
    _run(["cmake", "-S", str(HERE / "relay_cpp"), "-B", str(folder)])
    _run(["cmake", "--build", str(folder)])
    return folder


def build_twin(model: Path) -> Path:
    """Export `model` as a ROS package and build it; return its executable. Raises BuildError."""
    workspace = FOLDER / "twin"
    written = workspace / "written" / TWIN  # beside src, where colcon would find it twice
    shutil.rmtree(written, ignore_errors=True)
    written.parent.mkdir(parents=True, exist_ok=True)
    (written.parent / "COLCON_IGNORE").touch()
    _run([sys.executable, "-m", "ces_cli.main", "export", str(model), "--ros-package", str(written)])
    shutil.copytree(written, workspace / "src" / TWIN, copy_function=_copy_changed, dirs_exist_ok=True)
    flags = ["--cmake-args", "-DCMAKE_BUILD_TYPE=Release", "-DBUILD_TESTING=OFF"]
    _run(["colcon", "build", *flags], workspace)
    return workspace / "install" / TWIN / "lib" / TWIN / "observer"


def _copy_changed(source: str, target: str) -> None:
    """Copy a file unless it is the same, which would be compiled again."""
    if not Path(target).exists() or Path(source).read_bytes() != Path(target).read_bytes():
        shutil.copyfile(source, target)


def _run(command: Sequence[str], folder: Path = ROOT) -> None:
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BuildError(f"{command[0]}: {error}") from None
    if done.returncode:
        raise BuildError(f"{' '.join(command[:4])}: {' '.join((done.stderr or done.stdout).split()[-40:])}")
