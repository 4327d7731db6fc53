import numpy as np
import pytest

from ces_data.recording import Channel, Recording
from ces_identify.simulations.simulation import FunctionSimulation, RecordedSimulation, function_simulation
from ces_observer.errors import CesError

STAMPS = np.arange(100) * 1_000_000 + 5


def recording(**more):
    x = np.linspace(0, 1, 100)
    x[3] = np.nan
    channels = {
        "position": Channel("position", "m", STAMPS, x),
        "current": Channel("current", "A", STAMPS, np.full(100, 0.5)),
    }
    return Recording("made", {**channels, **more})


def test_a_function_gets_time_from_the_first_sample_and_answers_for_every_good_one():
    force = FunctionSimulation("f", lambda t, x, i: 1e3 * t + 10 * x + i).force(recording())
    assert np.isnan(force[3])
    np.testing.assert_allclose(force[4], 4.0 + 10 * 4 / 99 + 0.5)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda t, x, i: 1 / 0, "f: raised ZeroDivisionError"),
        (lambda t, x: x, r"f: raised TypeError: .*; it gets \(time_s, position_m, current_A\)"),
        (lambda t, x, i: x[:-1], r"f: returned shape \(98,\); expected \(99,\)"),
        (lambda t, x, i: x * np.nan, "f: returned nan at 0.000 s"),
    ],
)
def test_a_function_that_fails_is_named(function, message):
    with pytest.raises(CesError, match=message):
        FunctionSimulation("f", function).force(recording())


def test_functions_are_imported_by_name():
    assert function_simulation("numpy:hypot").function is np.hypot
    with pytest.raises(CesError, match="cannot be imported"):
        function_simulation("numpy:nothing")
    with pytest.raises(CesError, match="expected function"):
        function_simulation("numpy:pi")


def test_recorded_predictions_are_interpolated():
    predicted = Channel("sim_force", "N", STAMPS[::2], np.arange(50) * 2.0)
    force = RecordedSimulation("/p").force(recording(sim_force=predicted))
    np.testing.assert_allclose(force[:5], [0, 1, 2, 3, 4])
    with pytest.raises(CesError, match="no predictions on topic /p"):
        RecordedSimulation("/p").force(recording())
