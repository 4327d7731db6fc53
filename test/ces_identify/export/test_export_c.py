"""The exported C is the estimator's twin: compiled without a warning, the same forces and reasons on rough input."""

import ctypes
import math
import random
import struct
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from bands import BAND
from constructed_models import TERMS as CONSTRUCTED
from exported_c import (
    CODES,
    INPUTS,
    UNPROVED,
    c_steps,
    c_ticks,
    compile_c,
    half_ticks,
    hostile,
    python_steps,
    python_ticks,
    seeded,
    undefined_and_defined,
)
from physical_examples import ENVELOPE, SAMPLING, make_chambers, make_model, make_relaxation, make_valve
from trained_models import FUZZY, NETWORK, fuzzy_model, network_model

from ces_identify.export.export_c import LONGEST_NAME, NAME_ENDING, export_c, identifier
from ces_identify.structures.kit import number
from ces_observer.errors import ModelError
from ces_observer.model import Model, Sampling, parse_model
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.curves import FlowMap, IncreasingCurve
from ces_observer.structures.fuzzy import Bell, Premise, Rule
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.relaxation import Relaxation
from ces_observer.structures.terms import Factor, Term

# ---------------------------------------------------------------------------------------------------------- models


def f(signal, lag=0, power=1.0, signed=True):
    return Factor(signal, lag, power, signed)


def make(*terms, **sampling):
    settings = {"rate_Hz": 1000.0, "bandwidth_Hz": 90.0, "outlier_m": 0.004, "warm_up_s": 0.1, **sampling}
    return Model(Sampling(**settings), Polynomial(tuple(terms)), ENVELOPE, (-9e3, 8e3))


PLAIN = (
    Term(1200.0, (f("speed", 0, 0.5),)),
    Term(700.0, (f("speed", 2), f("current", 5, 1.0, False))),
    Term(100.1, (f("speed", 0, 0.5, False), f("current", 10, 2.0, False))),
    Term(30.0, (f("speed", 0, 1.5),)),
    Term(-5.0, ()),
    Term(0.3, (f("force", 1),)),
    Term(0.1, (f("force", 1), f("speed", 0, 0.5, False))),
    Term(-0.02, (f("force", 1), f("speed", 2), f("current", 5, 1.0, False))),
)
LAGS = (
    Term(1 / 3, (f("force", 1),)),
    Term(-0.1, (f("force", 2), f("current", 0))),
    Term(0.07, (f("force", 7), f("speed", 64, 1.0, False))),
    Term(0.05, (f("force", 33), f("current", 1), f("position", 3, 0.5, False))),
    Term(900.0, (f("speed", 1),)),
    Term(2000.0, (f("position", 100), f("current", 17, 2.0, False))),
)
MANY_FACTORS = (
    Term(800.0, (f("speed"), f("current", 1), f("current", 2))),
    Term(1e5, (f("position", 1), f("speed", 1, 1.0, False), f("current", 4), f("speed", 0, 0.5, False))),
    Term(400.0, (f("speed"), *(f("current", lag, 0.5) for lag in range(7)))),
    Term(0.4, (f("force", 3), f("current"), f("current", 1), f("current", 2), f("speed", 0, 0.0, False))),
)
POWERS = (
    Term(50.0, (f("speed", 0, 0.0),)),
    Term(7.0, (f("speed", 0, 0.0, False), f("current"))),
    *(Term(40.0 + p, (f("speed", 1, p),)) for p in (0.3, 1e-05, 0.75, 2.0, 2.5, 3.0, 4.0, 4.5, 5.0, 8.0)),
    *(Term(30.0 - p, (f("speed", 0, p, False),)) for p in (0.3, 1.0, 1.5, 3.5, 6.123456789012345)),
    Term(3e4, (f("position", 0, 1.25),)),
    Term(0.5, (f("force", 1), f("current", 0, 0.1, False))),
)
PUBLISHED = (  # two factors of the speed in a term, as in the thesis' noise model
    Term(900.0, (f("current", 0, 1.0, False), f("speed", 0, 0.6, False), f("speed", 1, 0.0))),
    Term(0.2, (f("force", 2), f("current", 1, 1.0, False), f("speed", 0, 1.0))),
    Term(-0.3, (f("force", 2), f("current", 0, 1.0, False), f("speed", 1, 0.2, False), f("speed", 3, 0.0))),
    Term(0.2, (f("force", 2), f("speed", 2, 1.0, False), f("speed", 0, 0.0))),
    Term(40.0, (f("speed", 1, 0.6, False),)),
)
UNSTABLE = (Term(1.02, (f("force", 1),)), Term(60.0, (f("speed"),)), Term(2.0, ()))


def drawn(seed):
    dice = random.Random(seed)
    powers = (0.0, 0.5, 1.0, 1.5, 2.0, 0.7, 3.0)

    def factor():
        return f(
            dice.choice(["speed", "current", "position"]), dice.randint(0, 20), dice.choice(powers), dice.random() < 0.5
        )

    def term(past):
        inputs = tuple(factor() for _ in range(dice.randint(0, 4)))
        return (
            Term(dice.uniform(-0.12, 0.12), (f("force", dice.randint(1, 12)), *inputs))
            if past
            else Term(dice.uniform(-300, 900), inputs)
        )

    return [term(k % 3 == 0) for k in range(20)]


ONE_INPUT = (Regressor("speed", 64, -0.1, 0.3),)
SLOW = replace(SAMPLING, rate_Hz=400.0, bandwidth_Hz=40.0, order=2)
LONG_GAP = replace(SAMPLING, rate_Hz=1333.3, max_gap_s=0.2, warm_up_s=0.0)
LARGEST = FlowMap(
    tuple((k - 20) / 40 for k in range(64)),
    tuple(tuple((k - 20) * (20.0 + row) + (k > 25) * 9.0 * row for k in range(64)) for row in range(16)),
)
SMALLEST = FlowMap((0.0, 1.0), ((0.0, 500.0), (0.0, 2000.0)))
LINE = IncreasingCurve((-100.0, 0.0), (-0.1, 0.0))
PLAIN_VALVE = make_valve(hysteresis_A=0.0)
MODELS = {
    "plain, order 3": lambda: make(*PLAIN),
    "plain, order 2, with a band": lambda: replace(make(*PLAIN, order=2), band=BAND),
    "many factors": lambda: make(*MANY_FACTORS, order=2, outlier_m=0.02),
    "powers": lambda: make(*POWERS, bandwidth_Hz=60.0),
    "published regressors": lambda: make(*PUBLISHED, warm_up_s=0.0),
    "slower ticks than samples": lambda: make(*PLAIN, rate_Hz=400.0, bandwidth_Hz=40.0),
    "several output lags, odd rate and a long gap": lambda: make(
        *LAGS, rate_Hz=1333.3, max_gap_s=0.2, order=2, warm_up_s=0.0
    ),
    "unstable": lambda: make(*UNSTABLE, warm_up_s=0.05),
    "a constant": lambda: make(Term(7.0, ())),
    "its own past only": lambda: make(Term(0.9, (f("force", 1),)), Term(10.0, ())),
    "no past": lambda: make(Term(900.0, (f("speed"),)), Term(1e4, (f("position", 0, 1.0, False),))),
    "ticks every 2^20 ns": lambda: make(*PLAIN, rate_Hz=1e9 / 2**20),
    "constructed inputs": lambda: make(*CONSTRUCTED),
    "constructed inputs without a lag": lambda: make(*CONSTRUCTED[:3], order=2),
    "drawn": lambda: make(*drawn(1)),
    "adaptive, order 3": lambda: make(*PLAIN, differentiator="adaptive", noise_m=15e-6),
    "adaptive, order 2": lambda: make(*PLAIN, differentiator="adaptive", noise_m=15e-6, order=2),
    "measured speed": lambda: make(*LAGS, differentiator="measured", order=2),
    "measured acceleration": lambda: make(*PLAIN, differentiator="fused", bandwidth_Hz=3.0),
    "network": network_model,
    "network of one input without units": lambda: network_model(
        replace(NETWORK, regressors=ONE_INPUT, linear=(0.7,), units=())
    ),
    "rules": fuzzy_model,
    "one rule": lambda: fuzzy_model(
        replace(
            FUZZY,
            regressors=ONE_INPUT,
            premises=(Premise("position", 7, (Bell(-0.01, 2.0, 0.5),)),),
            rules=(Rule((0,), 0.2, (0.5,)),),
        )
    ),
    "unstable rules": lambda: fuzzy_model(replace(FUZZY, rules=(Rule((0, 0), 0.1, (1.3, 0.0, 0.2, 0.0, 0.0)),))),
    "relaxation": lambda: make_model(make_relaxation(make_valve(5.7)), LONG_GAP),
    "relaxation, largest map, no springs": lambda: make_model(
        replace(make_relaxation(PLAIN_VALVE, springs=0), map=LARGEST), SLOW
    ),
    "chambers": lambda: make_model(make_chambers(make_valve(0.3), friction=3, friction_growth_1_N=0.0), LONG_GAP),
    "chambers, no friction": lambda: make_model(make_chambers(make_valve(), friction=0), SLOW),
    "chambers, smallest": lambda: make_model(
        replace(make_chambers(PLAIN_VALVE), map=SMALLEST, check=LINE, refill=LINE)
    ),
}
ALL_INPUTS = {"plain, order 3", "measured acceleration", "unstable", "network", "chambers"}


def inputs_of(name):
    """Return all inputs for a few models, the worst and three drawn ones for the others."""
    return INPUTS if name in ALL_INPUTS else [INPUTS[-1], half_ticks, *random.Random(name).sample(INPUTS[:-1], 3)]


def tolerance(model):
    """Return what forces may differ by [N]: the steps of a physical model are solved to a share of its largest."""
    return 1e-9 * (model.force_envelope_N[1] if isinstance(model.body, Chambers | Relaxation) else 1.0)


# ------------------------------------------------------------------------------------------------------------ twins


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Return a model of MODELS and its compiled library, by its name."""

    def find(name):
        model = MODELS[name]()
        return model, compile_c(tmp_path_factory.mktemp("model"), model)

    return cache(find)


@pytest.mark.slow
@pytest.mark.needs("cc")
@pytest.mark.parametrize("name", MODELS)
def test_forces_and_reasons_are_the_estimators(library, name) -> None:
    model, compiled = library(name)
    for shape in inputs_of(name):
        samples = seeded(shape)
        rows, reasons = c_steps(compiled, *samples)
        expected, expected_reasons = python_steps(model, *samples)
        np.testing.assert_array_equal(reasons, expected_reasons, shape.__name__)
        np.testing.assert_array_equal(rows[:, 3], expected[:, 3], shape.__name__)
        np.testing.assert_allclose(rows[:, 0], expected[:, 0], rtol=1e-9, atol=tolerance(model), err_msg=shape.__name__)
        np.testing.assert_allclose(rows[:, 1:3], expected[:, 1:3], rtol=1e-9, atol=1e-14, err_msg=shape.__name__)
        np.testing.assert_allclose(rows[:, 4], expected[:, 4], rtol=1e-9, err_msg=shape.__name__)
        np.testing.assert_array_equal(np.isnan(rows[:, 0]), reasons != CODES["ok"], shape.__name__)


@pytest.mark.slow
@pytest.mark.needs("cc")
def test_the_inputs_above_reach_every_reason(library) -> None:
    reached = {
        name: {reason for shape in INPUTS for reason in c_steps(library(name)[1], *seeded(shape))[1].tolist()}
        for name in ("plain, order 3", "unstable")
    }
    assert reached["plain, order 3"] == set(CODES.values()) - {CODES["force left its envelope"]}
    assert reached["unstable"] == set(CODES.values())


@pytest.mark.needs("cc")
def test_the_twins_are_compared_on_forces_and_on_an_unbounded_run(library) -> None:
    moving = c_steps(library("rules")[1], *seeded(INPUTS[0]))[0][:, 0]
    assert np.nanmax(np.abs(moving)) > 20.0
    assert math.isnan(c_steps(library("unstable rules")[1], *seeded(INPUTS[0]))[0][-1, 0])


@pytest.mark.slow
@pytest.mark.needs("cc")
@pytest.mark.parametrize("name", MODELS)
def test_a_tick_is_the_structures(library, name) -> None:
    model, compiled = library(name)
    dice = np.random.default_rng(7)
    calm = [dice.normal(0, spread, 1000) + mean for mean, spread in ((0, 0.01), (0, 0.8), (0.5, 0.3))]
    calm[1][::50] = 0.0
    if not isinstance(model.body, Chambers | Relaxation):
        calm[1][25::50] = np.nan
    for inputs in (calm, hostile(1000, 1)):
        forces, expected = c_ticks(compiled, *inputs), python_ticks(model, *inputs)
        assert np.isfinite(expected).any()
        np.testing.assert_allclose(forces, expected, rtol=1e-9, atol=tolerance(model))


# ------------------------------------------------------------------------------------------------------- the text


@pytest.mark.slow
@pytest.mark.needs("cc", "nm")
@pytest.mark.parametrize("name", ["powers", "network", "rules", "relaxation", "chambers"])
def test_it_needs_nothing_but_math_and_has_no_globals(library, name) -> None:
    needed, kinds = undefined_and_defined(Path(library(name)[1]._name).parent)
    assert needed <= {"cos", "exp", "floor", "fmin", "pow", "sqrt"}
    assert not {n for n, kind in kinds.items() if kind in "bBdDC"}
    assert {n for n, kind in kinds.items() if kind == "T"} == {
        "model_reset", "model_step", "model_tick", "model_past_reset"
    }  # fmt: skip


@pytest.mark.parametrize("name", ["plain, order 2, with a band", "rules", "relaxation", "chambers"])
def test_a_model_file_gives_the_same_code(name) -> None:
    model = MODELS[name]()
    again = parse_model(model.to_json(), "model.json")
    code = export_c(model, "m", "m", UNPROVED)
    assert export_c(again, "m", "m", UNPROVED) == code
    assert ("half_width" in "".join(code)) == (model.band is not None)


@pytest.mark.needs("cc")
def test_numbers_read_back_exactly(tmp_path):
    dice = random.Random(3)
    values = [5e-324, 1.7976931348623157e308, -0.0, 0.1, 1e22, 1e23, 1.0, -7.0]
    values += [struct.unpack("d", dice.randbytes(8))[0] for _ in range(2000)]
    values = [v for v in values if math.isfinite(v)]
    text = f"const double values[] = {{{', '.join(map(number, values))}}};\n"
    (tmp_path / "values.c").write_text(text)
    subprocess.run(["cc", "-std=c99", "-fPIC", "-shared", "-o", "v.so", "values.c"], cwd=tmp_path, check=True)
    read = (ctypes.c_double * len(values)).in_dll(ctypes.CDLL(str(tmp_path / "v.so")), "values")
    assert bytes(read) == struct.pack(f"{len(values)}d", *values)


def test_no_text_of_the_file_reaches_the_code():
    hostile = '*/ #error "hostile" \\\n'
    model = Model(
        make().sampling,
        Polynomial(PLAIN),
        make().envelope,
        (-9e3, 8e3),
        certificate={"claim": hostile, "gain": hostile, hostile: 1},
        provenance={"tool": hostile, hostile: [hostile]},
    )
    for text in export_c(model, "model", "model", model.certify()):
        assert "hostile" not in text
        assert model.digest() in text


def test_the_certificate_is_told():
    model = make(*PLAIN)
    proof = model.certify()
    assert proof.holds
    header = export_c(model, "model", "model", proof)[1]
    assert f"at most {proof.gain} < 1" in header
    assert f"never exceeds {proof.force_N} N" in header
    assert "NOT PROVED" not in header
    assert "NOT PROVED" in export_c(model, "model", "model", UNPROVED)[1]


def test_each_power_is_computed_once_and_roots_are_shared():
    source = export_c(make(*POWERS, *PLAIN), "model", "model", UNPROVED)[0]
    assert source.count("sqrt(speed_abs)") == 1
    assert source.count("pow(speed_abs, 0.3)") == 1
    assert "pow(speed_abs, 2" not in source
    assert "speed_abs_p2_5 = speed_abs * speed_abs * speed_abs_p0_5;" in source


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("damper", "damper"),
        ("My-Damper 2", "my_damper_2"),
        ("2nd", "model_2nd"),
        ("__x", "x"),
        ("dämpfer", "d_mpfer"),
        ("", "model"),
        ("*/;", "model"),
    ],
)
def test_identifiers_are_made_from_any_text(text, expected):
    assert identifier(text) == expected
    assert len(identifier("x" * 99) + NAME_ENDING) <= LONGEST_NAME  # what C99 tells apart


@pytest.mark.parametrize(
    ("name", "stem", "message"),
    [
        ("2x", "model", "name '2x': not usable in C; choose one such as 'model_2x'"),
        ("x; int y", "model", "choose one such as 'x_int_y'"),
        ("a" * 21, "model", f"choose one such as '{'a' * 20}'"),
        ("model", 'a"b', "file name"),
        ("model", "math", "standard header"),
    ],
)
def test_names_that_c_cannot_bear_are_refused(name, stem, message):
    with pytest.raises(ModelError, match=message):
        export_c(make(*PLAIN), name, stem, UNPROVED)


def test_numbers_that_are_not_finite_are_refused() -> None:
    for value in (math.inf, -math.inf, math.nan):
        with pytest.raises(ModelError, match="finite"):
            number(value)
