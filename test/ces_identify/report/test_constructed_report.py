"""Terms with constructed inputs on the report page: named, with their units, and adding up to the force."""

import re

import numpy as np
import pytest
from constructed_models import ENVELOPE, FREQUENCY, LOW, PLAY, STOP, constructed_damper, used

from ces_data.recording import Channel, Recording
from ces_identify.polynomial.term_table import coefficient_unit, format_term, term_forces
from ces_identify.prepare.series import prepare
from ces_identify.validation.evaluate import VALIDATION, evaluate
from ces_observer.structures.terms import Factor, Term


def plain(markup):
    return re.sub(r"<[^>]+>", "", markup.replace("<sup>", "^"))


@pytest.mark.parametrize(
    ("factors", "formula", "unit"),
    [
        ((used(STOP, 0, 0.5, True),), "sgn hysteresis(k) · |hysteresis(k)|^0.5", "N m^−0.5"),
        ((used(PLAY, 3, 2.0),), "remanence(k−3)^2", "N A^−2"),
        ((used(FREQUENCY, 0, 0.5), Factor("speed", 0)), "frequency(k)^0.5 · v(k)", "N Hz^−0.5 (m/s)^−1"),
        ((used(LOW, 8), Factor("force", 1)), "by_current_1(k−8) · F(k−1)", "1"),
    ],
)
def test_a_term_is_typeset_with_its_unit(factors, formula, unit):
    term = Term(1.0, factors)
    assert plain(format_term(term, ENVELOPE)) == formula
    assert plain(coefficient_unit(term)).replace("\N{NO-BREAK SPACE}", " ") == unit


def test_the_terms_add_up_to_the_force():
    t = np.arange(3000) * 1e-3
    stamps = np.rint(t * 1e9).astype(np.int64)
    rows = {"position": 0.03 * np.sin(20 * t), "current": 0.7 + 0.5 * np.sin(5 * t), "force": 500 * np.cos(20 * t)}
    channels = {name: Channel(name, "", stamps, values) for name, values in rows.items()}
    model = constructed_damper()
    (evaluation,) = evaluate(model, [prepare(Recording("r", channels), model.sampling)], VALIDATION)
    for start, values in term_forces(model.body, model, evaluation):
        np.testing.assert_allclose(values.sum(axis=0), evaluation.run.force[start : start + values.shape[1]], atol=1e-8)
