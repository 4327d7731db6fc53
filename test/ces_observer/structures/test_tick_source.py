"""What may stand in the text of a tick, whoever wrote the model: fixed names, numbers, and nothing else."""

import io
import math
import re
import token
import tokenize
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_examples import make_model

from ces_observer.errors import ModelError
from ces_observer.model import Envelope
from ces_observer.structures.constructed_inputs import RESERVED, Hysteresis, TriangularMembership
from ces_observer.structures.polynomial import tick_source
from ces_observer.structures.terms import Factor, Term

PYTHON = "def if else and not return abs min max sqrt copysign _ True False deque maxlen appendleft extend"
OWN = "make tick run clamped held hold update forces force"
WORDS = {*PYTHON.split(), *OWN.split()}
COUNTED = re.compile(r"(past_)?(size_)?(position|speed|current|made\d+|power\d+)(_\d+)?|force_\d+")
LAYOUT = {token.OP, token.NEWLINE, token.NL, token.INDENT, token.DEDENT, token.ENDMARKER}
HOSTILE = ["__import__('os').system('true')", "x\n    import os", '"""', "speed_2", "power0", "made0", "run", "\\", "é"]
texts = st.sampled_from(HOSTILE) | st.text(max_size=30)
names = texts.filter(lambda name: name not in RESERVED)  # as these are taken


def source_of(model):
    return tick_source(model.body.terms, model.operating_range)


def foreign(text):
    """Return what in the text is neither layout, nor a number, nor a name this package gave."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    known = [t for t in tokens if t.type not in LAYOUT | {token.NUMBER}]
    return [t.string for t in known if t.type != token.NAME or not (t.string in WORDS or COUNTED.fullmatch(t.string))]


def numbers(text):
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return {float(t.string) for t in tokens if t.type == token.NUMBER}


def model_with(name):
    made = Hysteresis(name, "stop", "position", 0.002)
    hat = TriangularMembership(name + "_1", name, None, 0.001, None, made)
    factors = Factor(name, 3, 0.7, False, made), Factor(hat.name, 1, 1.0, False, hat), Factor("force", 1)
    return make_model(terms=(Term(123.25, factors), Term(-7.5, (Factor("current", 4, 1.5),))))


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(name=names, said=texts)
def test_nothing_a_model_says_reaches_the_text(name, said):
    model = replace(model_with(name), provenance={said: said}, certificate={said: said, "proof": [said]})
    assert foreign(source_of(model)) == []
    assert source_of(model) == source_of(model_with("plain"))


def test_every_number_in_the_text_is_the_models_or_a_count():
    bounds = {0.1, 1.0, 0.0, 5000.0}
    assert numbers(source_of(model_with("plain"))) - bounds - set(range(6)) == {123.25, 7.5, 0.7}


class Loud:
    def __repr__(self):
        return "print('loud')"

    __str__ = __repr__

    def __format__(self, spec):
        return repr(self)


class LoudFloat(Loud, float):
    pass


class LoudInt(Loud, int):
    pass


def test_numbers_that_print_as_code_come_in_as_numbers():
    loud, lag = LoudFloat(0.5), LoudInt(2)
    factors = Factor("force", lag), Factor("speed", lag, LoudFloat(0.7), True)
    envelope = Envelope((-loud, loud), (LoudFloat(-2.0), LoudFloat(2.0)), (0.0, loud))
    model = make_model(terms=(Term(loud, factors),), envelope=envelope, force_envelope_N=(-loud, loud))
    assert foreign(source_of(model)) == []
    assert numbers(source_of(model)) == {0.5, 0.7, 2.0, 0.0, 3.0, 1.0}


NOT_FINITE = [math.nan, math.inf, -math.inf]


@pytest.mark.parametrize("bad", NOT_FINITE)
@pytest.mark.parametrize(
    ("what", "spoil"),
    [
        ("a coefficient", lambda bad: {"terms": (Term(bad, ()),)}),
        ("a power", lambda bad: {"terms": (Term(1.0, (Factor("speed", 0, bad),)),)}),
        ("the envelope of position", lambda bad: {"envelope": Envelope((-1.0, bad), (-1.0, 1.0), (0.0, 1.0))}),
        ("the force envelope", lambda bad: {"force_envelope_N": (bad, 1.0)}),
    ],
)
def test_a_number_that_is_not_finite_is_refused(bad, what, spoil):
    with pytest.raises(ModelError, match=f"{what} of the model is {bad!r}; expected a finite number"):
        make_model(**spoil(bad)).make_predictor()


def test_a_signal_without_a_definition_is_refused_in_one_line():
    with pytest.raises(ModelError, match="no such signal") as error:
        source_of(make_model(terms=(Term(1.0, (Factor("speed\nimport os", 0),)),)))
    assert "\n" not in str(error.value)


def test_each_power_is_computed_once_and_each_lag_read_once():
    shared = Factor("speed", 0, 0.5), Factor("speed", 2, 0.5), Factor("speed", 0, 0.5, signed=False)
    text = source_of(make_model(terms=tuple(Term(c, (f,)) for c in (1.0, 2.0, 3.0) for f in shared)))
    assert text.count("sqrt(") == 1
    assert text.count("abs(") == 1
    assert text.count("[2]") == 1
    assert text.count("appendleft(") == 1


def test_a_model_without_lags_keeps_nothing():
    text = source_of(make_model(terms=(Term(2.0, (Factor("speed", 0, 2.0),)),)))
    assert "past_" not in text
    assert "appendleft" not in text
