"""The C++ package's controller in a controller manager of ros2_control, with mock hardware at 1 kHz."""

from __future__ import annotations

import io
import os
import random
import subprocess
from math import inf, nan
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

import numpy as np
from cpp_package import CACHE, PACKAGE, CppPackage, cache_of, missing_tool
from patience import PATIENCE_S
from replay import MS, START_NS
from vehicle import stroke

from ces_observer.current_hold import ConstantCurrent, CurrentHold
from ces_observer.damper_observer import DamperObserver
from ces_observer.health.episodes import Stillness
from ces_observer.model import load_model

PREFIXES = os.environ.get("AMENT_PREFIX_PATH", "").split(":")
HAS_CONTROL = any(Path(prefix, "share", "controller_manager").is_dir() for prefix in PREFIXES)
pytestmark = pytest.mark.skipif(
    bool(missing_tool()) or not HAS_CONTROL, reason=f"{missing_tool() or 'controller_manager'} is missing"
)

Script = list[list[tuple[int, float, float]]]  # parts of samples: stamp [ns], position [m], current [A]
SOURCE = Path(__file__).parent / "control"
SCALE = 10.0  # of both interfaces: the mock passes no infinity on, but 1e308, which is one as position or current
STILL_S = 0.2
COLUMNS = [
    *(("part", int), ("stamp", int), ("position", float), ("current", float), ("force", float)),
    *(("allocations", int), ("cycle_us", float), ("update_us", float)),
]
URDF = """<robot name="rig"><link name="body"/><link name="wheel"/>
  <joint name="damper" type="prismatic">
    <parent link="body"/><child link="wheel"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="9000" velocity="3"/>
  </joint>
  <ros2_control name="mock" type="system">
    <hardware><plugin>mock_components/GenericSystem</plugin></hardware>
    <joint name="damper">
      <command_interface name="position"/><command_interface name="current"/>
      <state_interface name="position"/><state_interface name="current"/>
    </joint>
  </ros2_control>
</robot>
"""
CONTROLLERS = """controller_manager:
  ros__parameters: {update_rate: 1000, damper_force: {type: %s/DamperForceController}}
damper_force:
  ros__parameters: {%s}
"""
PARAMETERS = f"model: %s, joint: damper, position: {{scale: {SCALE}}}, current: {{%s}}"


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the program with the controller manager."""
    folder = tmp_path_factory.mktemp("control")
    words = ["cmake", "-S", SOURCE, "-B", folder, "-DCMAKE_BUILD_TYPE=Release", *CACHE]
    for command in (words, ["cmake", "--build", folder]):
        environment = {**os.environ, **cache_of(folder)}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, done.stdout + done.stderr
    return folder / "control_loop"


def make_script() -> Script:
    """Return two parts, the first with faults."""
    chance = random.Random(7)
    times = [k * MS + chance.randrange(MS // 2) for k in range(3600)]
    rows = [(START_NS + time, stroke(time * 1e-9), 0.5 + 0.1 * (time // (50 * MS) % 7)) for time in times]
    for k in (500, 501):
        rows[k] = (rows[k][0], inf, rows[k][2])
    rows[600] = (rows[600][0], 0.09, rows[600][2])
    rows[900:1300] = [(stamp, rows[900][1], current) for stamp, _, current in rows[900:1300]]
    rows[1700:2000] = [(stamp, position, inf) for stamp, position, _ in rows[1700:2000]]
    return [rows[:2300] + rows[2700:2900], rows[2900:]]  # a gap longer than the model bridges


def raw(value: float) -> float:
    return min(value / SCALE, 1e308)


def run(program: Path, package: CppPackage, folder: Path, script: Script, settings: str) -> tuple[int, str, str]:
    """Play the script with these parameters of the controller; return exit status, output and log."""
    lines = ("".join(f"{t} {raw(x)!r} {raw(i)!r}\n" for t, x, i in part) for part in script)
    files = {"rig.urdf": URDF, "script": "\n".join(lines), "controllers.yaml": CONTROLLERS % (PACKAGE, settings)}
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    words = [program, *list(files)[:2], "--ros-args", "--params-file", "controllers.yaml"]
    done = subprocess.run(
        words, cwd=folder, env=package.environment, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    return done.returncode, done.stdout, done.stderr


def require_forces_of_python(output: str, model: Path, current: CurrentHold) -> np.ndarray:
    """Return what the controller after `damper_force` has seen, a row for each update; its forces are Python's."""
    rows = np.loadtxt(io.StringIO(output), dtype=COLUMNS)
    for part in (0, 1):
        seen = rows[rows["part"] == part]
        np.testing.assert_allclose(seen["force"], replay(model, seen, current), rtol=0.0, atol=0.0)
    assert np.nanmax(np.abs(rows["force"])) > 100.0
    return rows


def replay(model: Path, rows: np.ndarray, current: CurrentHold) -> np.ndarray:
    """Return the forces of the observer in Python for the same samples; NaN: withheld."""
    damper, stillness = DamperObserver(load_model(model), current, 0.0), Stillness(STILL_S)
    forces = []
    for stamp, position, held in rows[["stamp", "position", "current"]].tolist():
        damper.take_current(stamp, SCALE * held)
        force = damper.step(stamp, SCALE * position, stamp)
        stillness.take(stamp, position)
        forces.append(nan if force is None or stillness.resting else force)
    return np.array(forces)


def test_the_next_controller_gets_the_forces_of_python(
    program: Path, package: CppPackage, banded_path: Path, flat_path: Path, tmp_path: Path
) -> None:
    script = make_script()
    status, output, log = run(program, package, tmp_path, script, PARAMETERS % (flat_path, f"scale: {SCALE}"))
    assert status == 0, log
    rows = require_forces_of_python(output, banded_path, CurrentHold(0.2))
    for fault in ((501, 503), (601, 602), (1103, 1300), (1903, 2000)):  # no position, outlier, stalled, no current;
        faulty = [stamp for stamp, *_ in script[0][slice(*fault)]]  # the mock takes a command at its next update
        assert np.isnan(rows["force"][np.isin(rows["stamp"], faulty)]).sum() == len(faulty), fault
    assert np.isfinite(rows["force"]).sum() > 2000
    for part in (0, 1):  # switching allocates
        assert not rows["allocations"][rows["part"] == part][:-1].any()
    assert np.median(rows["update_us"]) < 50.0
    assert "damping force withheld: no usable current" in log


def test_a_constant_current_needs_no_interface(
    program: Path, package: CppPackage, banded_path: Path, flat_path: Path, tmp_path: Path
) -> None:
    clean = make_script()[1]
    status, output, log = run(
        program, package, tmp_path, [clean[:400], clean[400:]], PARAMETERS % (flat_path, "constant: 0.7")
    )
    assert status == 0, log
    rows = require_forces_of_python(output, banded_path, ConstantCurrent(0.7))
    assert np.isfinite(rows["force"]).sum() > 400


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("model: /m.ces, max_still_s: 0.5", "Parameter 'joint' cannot be empty"),
        (PARAMETERS % ("/no/m.ces", "scale: 1.0"), "/no/m.ces: no such model file"),
        (
            PARAMETERS % ("%s", "scale: 0.0"),
            "scale and offset of damper/current: expected finite numbers, a scale other than 0",
        ),
    ],
)
def test_wrong_parameters_are_refused(
    program: Path, package: CppPackage, flat_path: Path, tmp_path: Path, settings: str, message: str
) -> None:
    status, _, log = run(program, package, tmp_path, make_script(), settings.replace("%s", str(flat_path)))
    assert status == 1
    assert log.count(message) == 1
