"""The package ces_observer_cpp, built with colcon unless it is sourced, and its programs as processes."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

from node_process import NodeProcess, ros_args

PACKAGE = "ces_observer_cpp"
SOURCE = Path(__file__).resolve().parents[2] / PACKAGE
FLAGS = ("-DCMAKE_CXX_FLAGS=-Werror", "-DCMAKE_C_FLAGS=-Werror")
# What was compiled before need not be compiled again.
CACHE = [f"-DCMAKE_{language}_COMPILER_LAUNCHER=ccache" for language in ("C", "CXX") if shutil.which("ccache")]
PREFIXES = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if prefix]


def missing_tool() -> str:
    """Return what is missing to build the package; empty: nothing."""
    for package in ("rclcpp_components", "rclcpp_lifecycle", "diagnostic_updater", "generate_parameter_library"):
        if not any((prefix / "share" / package).is_dir() for prefix in PREFIXES):
            return package
    return next((tool for tool in ("colcon", "cmake", "c++") if shutil.which(tool) is None), "")


def cache_of(folder: Path) -> dict[str, str]:
    """Return the variables with which a build in a temporary folder hits the user's cache of one in another."""
    home = os.environ.get("CCACHE_DIR", str(Path.home() / ".cache" / "ccache"))  # XDG_CACHE_HOME is the tests' own
    return {"CCACHE_DIR": home, "CCACHE_BASEDIR": str(folder), "CCACHE_NOHASHDIR": "1"}


class CppPackage:
    """The package in a workspace of its own; `log` is what the build printed, empty if it was sourced."""

    def __init__(self, workspace: Path) -> None:
        self.log = ""
        self.environment = dict(os.environ)
        if not any((prefix / "share" / PACKAGE).is_dir() for prefix in PREFIXES):
            self._build(workspace)
        prefixes = self.environment["AMENT_PREFIX_PATH"].split(":")
        found = next(Path(prefix) for prefix in prefixes if Path(prefix, "share", PACKAGE).is_dir())
        self.program = found / "lib" / PACKAGE / "observer"

    def start(
        self, namespace: str, name: str, parameters: Mapping[str, object], variables: Mapping[str, str] | None = None
    ) -> NodeProcess:
        """Start the program as the node `name`, with further `variables` in its environment."""
        words = [str(self.program), *ros_args(namespace, parameters), "-r", f"__node:={name}"]
        return NodeProcess(words, {**self.environment, **(variables or {})})

    def _build(self, workspace: Path) -> None:
        (workspace / "src").mkdir(parents=True)
        (workspace / "src" / PACKAGE).symlink_to(SOURCE)
        words = ["colcon", "build", "--event-handlers", "console_direct+", "--cmake-args", *FLAGS, *CACHE]
        environment = self.environment | cache_of(workspace)
        done = subprocess.run(words, cwd=workspace, capture_output=True, text=True, check=False, env=environment)
        self.log = done.stdout + done.stderr
        assert done.returncode == 0, self.log
        script = f". {workspace}/install/local_setup.sh && env -0"
        listed = subprocess.run(["sh", "-c", script], capture_output=True, text=True, check=True)
        self.environment = dict(line.split("=", 1) for line in listed.stdout.split("\0") if line)
