"""Constructed inputs over whole arrays."""

import numpy as np
from constructed_models import ENVELOPE, FREQUENCY, HIGH, LAG, LONG, LOW, MID, PLAY, SHORT, STOP

from ces_identify.polynomial.problem import lay_out_terms, probe, signal_values
from ces_observer.structures.polynomial import Factor, Term

ALL = (STOP, PLAY, LAG, FREQUENCY, LOW, MID, HIGH, SHORT, LONG)
SEGMENTS = np.array([[0, 700], [700, 701], [705, 2000]])


def rough(n=2000, seed=5):
    """Position, speed and current that leave the envelope now and then."""
    random = np.random.default_rng(seed)
    t = np.arange(n) * 1e-3
    x = 0.04 * np.sin(7 * t) + 0.02 * np.sin(50 * t) + random.normal(0, 1e-4, n)
    return np.stack([x, random.normal(0, 1.0, n), 0.7 + random.normal(0, 0.5, n)])


def test_constructed_inputs_stay_in_their_ranges_and_begin_anew_in_each_segment():
    inputs = rough()
    values = signal_values(ALL, ENVELOPE, inputs, SEGMENTS, 1000.0)
    assert list(values) == ["position", "speed", "current", *(one.name for one in ALL)]
    inside = np.concatenate([np.arange(*segment) for segment in SEGMENTS])
    for one in ALL:
        low, high = one.range(ENVELOPE.by_signal)
        row = values[one.name][inside]
        assert low <= row.min() < row.max() <= high
    assert [values[STOP.name][start] for start, _ in SEGMENTS] == [0.0] * 3
    np.testing.assert_array_equal(values[LAG.name][SEGMENTS[:, 0]], values["current"][SEGMENTS[:, 0]])


def test_probes_take_a_membership_for_what_it_is_and_go_through_its_kinks():
    """Of three blended gains of 0.9 at most one counts at a time; a probe misses none of their peaks."""
    terms = [Term(1.0, (Factor("force", 1), Factor(hat.name, 8, 1.0, False, hat))) for hat in (LOW, MID, HIGH)]
    terms.append(Term(1.0, (Factor("force", 1), Factor("current", 8, 1.0, False))))
    probes = probe(lay_out_terms(terms), ENVELOPE)
    np.testing.assert_allclose(probes[:3].sum(axis=0), 1.0, rtol=1e-14)
    np.testing.assert_allclose(probes[:3].max(axis=1), 1.0)
    np.testing.assert_allclose(probes[0], [LOW.at(x) for x in probes[3]])
