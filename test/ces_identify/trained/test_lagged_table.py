import numpy as np

from ces_identify.trained.training import delay_values, regressor_table
from ces_observer.model import Envelope
from ces_observer.structures.lagged_signals import Regressor


def test_delays_do_not_cross_segments():
    segments = np.array([[0, 3], [3, 7]])
    np.testing.assert_array_equal(delay_values(np.arange(7.0), 2, segments), [0, 0, 0, 3, 3, 3, 4])


def test_a_table_is_clamped_then_scaled_and_leaves_room_for_past_forces():
    envelope = Envelope((-1.0, 1.0), (-0.5, 0.5), (0.0, 1.0))
    regressors = (
        Regressor("speed", 1, 0.25, 0.5),
        Regressor("force", 3, 10.0, 50.0),
        Regressor("current", 0, 0.0, 2.0),
    )
    inputs = np.array([[0.0, 0.0, 0.0], [0.1, 9.0, -9.0], [0.5, 2.0, -1.0]])
    table = regressor_table(regressors, envelope, inputs, np.array([[0, 3]]))
    np.testing.assert_allclose(table.values[:, 0], [-0.3, -0.3, 0.5])
    np.testing.assert_array_equal(table.values[:, 1], 0.0)
    np.testing.assert_allclose(table.values[:, 2], [0.25, 0.5, 0.0])
    assert [a.tolist() for a in table[1:]] == [[0, 3, 0], [0.0, 10.0, 0.0], [1.0, 50.0, 1.0]]
