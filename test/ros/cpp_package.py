"""A package written by `ces export --ros-package`, built with colcon, and its programs as processes."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

from node_process import NodeProcess, ros_args

from ces_cli.identify import export

PACKAGE = "damper_twin"
FLAGS = ("-DBUILD_TESTING=ON", "-DCMAKE_CXX_FLAGS=-Werror", "-DCMAKE_C_FLAGS=-Werror")


def missing_tool() -> str:
    """Return what is missing to build such a package; empty: nothing."""
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if prefix]
    for package in ("rclcpp_components", "rclcpp_lifecycle", "diagnostic_updater", "generate_parameter_library"):
        if not any((prefix / "share" / package).is_dir() for prefix in prefixes):
            return package
    return next((tool for tool in ("colcon", "cmake", "c++") if shutil.which(tool) is None), "")


class CppPackage:
    """The package in a workspace of its own; `log` is what the build printed."""

    def __init__(self, workspace: Path, model: Path) -> None:
        self.workspace = workspace
        (workspace / "src").mkdir(parents=True)
        assert export.main([str(model), "--ros-package", str(workspace / "src" / PACKAGE)]) == 0
        words = ["colcon", "build", "--event-handlers", "console_direct+", "--cmake-args", *FLAGS]
        env = dict(os.environ)
        if shutil.which("ccache") is not None:  # wherever the workspace is
            words += [f"-DCMAKE_{language}_COMPILER_LAUNCHER=ccache" for language in ("C", "CXX")]
            env |= {"CCACHE_BASEDIR": str(workspace), "CCACHE_NOHASHDIR": "1"}
        done = subprocess.run(words, cwd=workspace, capture_output=True, text=True, check=False, env=env)
        self.log = done.stdout + done.stderr
        assert done.returncode == 0, self.log
        script = f". {workspace}/install/local_setup.sh && env -0"
        listed = subprocess.run(["sh", "-c", script], capture_output=True, text=True, check=True)
        self.environment = dict(line.split("=", 1) for line in listed.stdout.split("\0") if line)

    def start(
        self, namespace: str, name: str, parameters: Mapping[str, object], variables: Mapping[str, str] | None = None
    ) -> NodeProcess:
        """Start the program as the node `name`, with further `variables` in its environment."""
        program = self.workspace / "install" / PACKAGE / "lib" / PACKAGE / "observer"
        words = [str(program), *ros_args(namespace, parameters), "-r", f"__node:={name}"]
        return NodeProcess(words, {**self.environment, **(variables or {})})

    def replay(self) -> str:
        """Run the package's own test; return its output."""
        words = ["ctest", "--output-on-failure"]
        done = subprocess.run(
            words, cwd=self.workspace / "build" / PACKAGE, capture_output=True, text=True, check=False
        )
        return done.stdout
