"""The numbers that simulations declare, and simulators of users that fail."""

from pathlib import Path

import numpy as np
import pytest
from fmus import algebraic_fmu, changed
from test_simulation import recording

from ces_gap.baseline.wrappers import InputTiming, RetimedSimulation
from ces_identify.simulations.fmu import open_fmu
from ces_identify.simulations.parameters import Parameter
from ces_identify.simulations.simulation import FunctionSimulation, function_simulation
from ces_observer.errors import CesError


def force(time_s, position_m, current_A, *, seal_N=25.0, chambers=2, hot=False, oil="A", open_end=np.inf, none=None):
    return np.full_like(position_m, seal_N * chambers)


def test_a_function_declares_the_numbers_among_its_keyword_only_arguments():
    simulation = FunctionSimulation("f", force)
    assert simulation.parameters == (Parameter("seal_N", 25.0), Parameter("chambers", 2.0, whole=True))
    changed = simulation.with_values({"seal_N": 30.0}).with_values({"chambers": 3.0})
    assert changed.parameters[0].default == 30.0
    assert np.nanmax(changed.force(recording())) == 90.0
    assert changed.values["chambers"] == 3 and isinstance(changed.values["chambers"], int)
    assert FunctionSimulation("f", lambda t, x, i: x).parameters == ()


def test_what_wraps_a_simulation_has_its_parameters():
    late = RetimedSimulation(FunctionSimulation("f", force), InputTiming(0.5))
    assert late.with_values({"seal_N": 50.0}).parameters[0].default == 50.0
    assert np.nanmax(late.with_values({"seal_N": 50.0}).force(recording())) == 100.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def force(time_s, position_m, current_A:\n", "SyntaxError"),
        ("import sys\nsys.exit('no licence')\n", "SystemExit: no licence"),
        ("1 / 0\n", "ZeroDivisionError"),
    ],
)
def test_a_users_file_that_cannot_be_imported_is_one_line(text, message, tmp_path: Path, monkeypatch):
    name = f"broken_{abs(hash(text))}"
    (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(CesError, match=message) as raised:
        function_simulation(f"{name}:force")
    assert "\n" not in str(raised.value)


def test_a_users_function_that_ends_the_program_is_one_line():
    with pytest.raises(CesError, match="f: raised SystemExit: 3"):
        FunctionSimulation("f", lambda t, x, i: (_ for _ in ()).throw(SystemExit(3))).force(recording())


@pytest.mark.slow
@pytest.mark.needs("cc")
def test_the_parameters_of_an_fmu_are_set_before_it_starts(tmp_path):
    pytest.importorskip("fmpy")
    declared = (
        '<ScalarVariable name="gain" valueReference="4" causality="parameter" variability="fixed">'
        '<Real unit="mm" start="1.5" min="0.5" max="4"/></ScalarVariable></ModelVariables>'
    )
    source = {"in[3]": "in[5] = {0, 0, 0, 0, 1.5}", "out = 1500.0": "out = 1000.0 * in[4]"}
    source |= {"memset(in, 0, sizeof in);": "in[0] = in[1] = in[2] = 0; in[4] = 1.5;"}
    path = changed(algebraic_fmu(tmp_path, changes=source), {"</ModelVariables>": declared})
    fmu = open_fmu(str(path))
    assert fmu.parameters == (Parameter("gain", 1.5, 0.5, 4.0, "mm"),)
    doubled = fmu.with_values({"gain": 3.0})
    assert doubled.parameters[0].default == 3.0
    at_rest = fmu.with_values({"gain": 0.0}).force(recording())
    np.testing.assert_allclose(doubled.force(recording()) - at_rest, 2.0 * (fmu.force(recording()) - at_rest))
