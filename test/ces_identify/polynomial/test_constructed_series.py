"""Constructed inputs over whole arrays are those of the vehicle, tick by tick."""

import numpy as np
from constructed_models import ENVELOPE, FREQUENCY, HIGH, LAG, LONG, LOW, MID, PLAY, SHORT, STOP

from ces_identify.polynomial.compiled_terms import compile_terms, membership, signal_values
from ces_identify.polynomial.problem import probe
from ces_observer.structures.constructed_inputs import InputConstructor
from ces_observer.structures.terms import Factor, Term

ALL = (STOP, PLAY, LAG, FREQUENCY, LOW, MID, HIGH, SHORT, LONG)
SEGMENTS = np.array([[0, 700], [700, 701], [705, 2000]])


def rough(n=2000, seed=5):
    """Position, speed and current that leave the envelope now and then."""
    random = np.random.default_rng(seed)
    t = np.arange(n) * 1e-3
    x = 0.04 * np.sin(7 * t) + 0.02 * np.sin(50 * t) + random.normal(0, 1e-4, n)
    return np.stack([x, random.normal(0, 1.0, n), 0.7 + random.normal(0, 0.5, n)])


def stepped(inputs):
    run, out = InputConstructor(ALL, 1000.0), np.zeros((len(ALL), inputs.shape[1]))
    for start, stop in SEGMENTS:
        run.reset()
        for k in range(start, stop):
            bounds = (ENVELOPE.position_m, ENVELOPE.speed_m_s, ENVELOPE.current_A)
            row = [min(max(v, low), high) for v, (low, high) in zip(inputs[:, k].tolist(), bounds, strict=True)]
            out[:, k] = run.update(row)[3:]
    return out


def test_batch_and_step_by_step_are_the_same_to_the_last_digit():
    inputs = rough()
    values = signal_values(ALL, ENVELOPE, inputs, SEGMENTS, 1000.0)
    assert list(values) == ["position", "speed", "current", *(one.name for one in ALL)]
    expected = stepped(inputs)
    inside = np.concatenate([np.arange(*segment) for segment in SEGMENTS])
    for one, row in zip(ALL, expected, strict=True):
        np.testing.assert_array_equal(values[one.name][inside], row[inside], one.name)
        low, high = one.range(ENVELOPE.by_signal)
        assert low <= row[inside].min() < row[inside].max() <= high


def test_probes_take_a_membership_for_what_it_is_and_go_through_its_kinks():
    """Of three blended gains of 0.9 at most one counts at a time; a probe misses none of their peaks."""
    terms = [Term(1.0, (Factor("force", 1), Factor(hat.name, 8, 1.0, False, hat))) for hat in (LOW, MID, HIGH)]
    terms.append(Term(1.0, (Factor("force", 1), Factor("current", 8, 1.0, False))))
    probes = probe(compile_terms(terms), ENVELOPE)
    np.testing.assert_allclose(probes[:3].sum(axis=0), 1.0, rtol=1e-14)
    np.testing.assert_allclose(probes[:3].max(axis=1), 1.0)
    np.testing.assert_allclose(probes[0], membership(LOW, probes[3]))
