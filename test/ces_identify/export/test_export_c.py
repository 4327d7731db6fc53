"""The exported C is the estimator's twin: compiled without a warning, the same forces and reasons on rough input."""

import ctypes
import math
import random
import struct
import subprocess
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bands import BAND
from constructed_models import TERMS as CONSTRUCTED
from exported_c import (
    CODES,
    COUNT,
    INPUTS,
    UNPROVED,
    c_steps,
    c_ticks,
    compile_c,
    pointers,
    python_steps,
    python_ticks,
    seeded,
    undefined_and_defined,
)

from ces_identify.export.export_c import LONGEST_NAME, NAME_ENDING, export_c, identifier
from ces_identify.structures.kit import number
from ces_observer.errors import ModelError
from ces_observer.estimator import Estimator
from ces_observer.model import Envelope, Model, Sampling
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

BAND_HARNESS = """
#include "model.h"
#include <string.h>

void widths(int64_t n, const int64_t *stamps, const double *positions, const double *currents, double *out)
{
    model_state state;
    double force;
    memset(&state, 0x01, sizeof state);
    model_reset(&state);
    for (int64_t i = 0; i < n; i++) {
        const bool good = model_step(&state, stamps[i], positions[i], currents[i], &force) == MODEL_OK;
        out[i] = good ? model_half_width(&state) : -1.0;
    }
}
"""


# ---------------------------------------------------------------------------------------------------------- models


def f(signal, lag=0, power=1.0, signed=True):
    return Factor(signal, lag, power, signed)


def make(*terms, **sampling):
    settings = {"rate_Hz": 1000.0, "bandwidth_Hz": 90.0, "outlier_m": 0.004, "warm_up_s": 0.1, **sampling}
    envelope = Envelope((-0.018, 0.018), (-1.5, 1.4), (0.1, 0.9))
    return Model(Sampling(**settings), Polynomial(tuple(terms)), envelope, (-9e3, 8e3))


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


MODELS = {
    "plain, order 3": make(*PLAIN),
    "plain, order 2": make(*PLAIN, order=2),
    "several output lags": make(*LAGS, warm_up_s=0.0),
    "many factors": make(*MANY_FACTORS, order=2, outlier_m=0.02),
    "powers": make(*POWERS, bandwidth_Hz=60.0),
    "published regressors": make(*PUBLISHED, warm_up_s=0.0),
    "slower ticks than samples": make(*PLAIN, rate_Hz=400.0, bandwidth_Hz=40.0),
    "odd rate and a long gap": make(*LAGS, rate_Hz=1333.3, max_gap_s=0.2, order=2),
    "unstable": make(*UNSTABLE, warm_up_s=0.05),
    "a constant": make(Term(7.0, ())),
    "its own past only": make(Term(0.9, (f("force", 1),)), Term(10.0, ())),
    "no past": make(Term(900.0, (f("speed"),)), Term(1e4, (f("position", 0, 1.0, False),))),
    "ticks every 2^20 ns": make(*PLAIN, rate_Hz=1e9 / 2**20),
    "constructed inputs": make(*CONSTRUCTED),
    "constructed inputs without a lag": make(*CONSTRUCTED[:3], order=2),
    "drawn, order 3": make(*drawn(1)),
    "drawn, order 2": make(*drawn(2), order=2),
    "adaptive, order 3": make(*PLAIN, differentiator="adaptive", noise_m=15e-6),
    "adaptive, order 2": make(*PLAIN, differentiator="adaptive", noise_m=15e-6, order=2),
    "measured speed, order 3": make(*PLAIN, differentiator="measured"),
    "measured speed, order 2": make(*LAGS, differentiator="measured", order=2),
    "measured acceleration": make(*PLAIN, differentiator="fused", bandwidth_Hz=3.0),
}
BANDED = replace(make(*PLAIN), band=BAND)


# ------------------------------------------------------------------------------------------------------------ twins


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Return the compiled library of a model of MODELS, by its name."""
    return cache(lambda name: compile_c(tmp_path_factory.mktemp("model"), MODELS[name]))


@pytest.mark.needs("cc")
@pytest.mark.parametrize("shape", INPUTS)
@pytest.mark.parametrize("name", MODELS)
def test_forces_and_reasons_are_the_estimators(library, name, shape):
    samples = seeded(shape)
    rows, reasons = c_steps(library(name), *samples)
    expected, expected_reasons = python_steps(MODELS[name], *samples)
    np.testing.assert_array_equal(reasons, expected_reasons)
    np.testing.assert_array_equal(rows[:, 3], expected[:, 3])
    np.testing.assert_allclose(rows[:, 0], expected[:, 0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(rows[:, 1:3], expected[:, 1:3], rtol=1e-9, atol=1e-14)
    np.testing.assert_array_equal(np.isnan(rows[:, 0]), reasons != CODES["ok"])


@pytest.fixture(scope="module")
def band_library(tmp_path_factory):
    return compile_c(tmp_path_factory.mktemp("band"), BANDED, harness=BAND_HARNESS)


@pytest.mark.needs("cc")
@pytest.mark.parametrize("shape", INPUTS)
def test_half_widths_are_the_estimators(band_library, shape):
    samples = seeded(shape)
    arrays = [np.ascontiguousarray(a, kind) for a, kind in zip(samples, (np.int64, float, float), strict=True)]
    widths, e = np.full(len(arrays[0]), 1e9), Estimator(BANDED)
    band_library.widths(ctypes.c_int64(len(widths)), *pointers(*arrays, widths))
    rows = zip(*(a.tolist() for a in arrays), strict=True)
    expected = [-1.0 if e.step(*row) is None else e.half_width() for row in rows]
    np.testing.assert_allclose(widths, expected, rtol=1e-9)


def test_without_a_band_the_code_has_none():
    assert "half_width" not in "".join(export_c(MODELS["a constant"], "model", "model", UNPROVED))


@pytest.mark.needs("cc")
def test_the_inputs_above_reach_every_reason(library):
    reached = {name: set() for name in MODELS}
    for name in ("plain, order 3", "unstable"):
        for shape in INPUTS:
            reached[name] |= set(c_steps(library(name), *seeded(shape))[1].tolist())
    assert reached["plain, order 3"] == set(CODES.values()) - {CODES["force left its envelope"]}
    assert reached["unstable"] == set(CODES.values())


@pytest.mark.needs("cc")
@pytest.mark.parametrize("name", MODELS)
def test_a_tick_is_the_polynomials(library, name):
    dice = np.random.default_rng(7)
    inputs = [dice.normal(0, spread, COUNT) + mean for mean, spread in ((0, 0.01), (0, 0.8), (0.5, 0.3))]
    inputs[1][::50] = 0.0
    inputs[1][25::50] = np.nan
    forces, expected = c_ticks(library(name), *inputs), python_ticks(MODELS[name], *inputs)
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(forces, expected, rtol=1e-9, atol=1e-9)


# ------------------------------------------------------------------------------------------------------- the text


@pytest.mark.needs("cc", "nm")
@pytest.mark.parametrize("name", ["plain, order 3", "powers"])
def test_it_needs_nothing_but_math_and_has_no_globals(tmp_path, name):
    compile_c(tmp_path, MODELS[name])
    needed, kinds = undefined_and_defined(tmp_path)
    assert needed <= {"cos", "exp", "floor", "pow", "sqrt"}
    assert not {n for n, kind in kinds.items() if kind in "bBdDC"}
    assert {n for n, kind in kinds.items() if kind == "T"} == {
        "model_reset", "model_step", "model_tick", "model_past_reset"
    }  # fmt: skip


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


def test_identifiers_stay_within_what_c99_tells_apart():
    assert len(identifier("x" * 99) + NAME_ENDING) <= LONGEST_NAME


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
    with pytest.raises(ModelError, match=message.replace("(", r"\(")):
        export_c(make(*PLAIN), name, stem, UNPROVED)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_numbers_that_are_not_finite_are_refused(value):
    with pytest.raises(ModelError, match="finite"):
        number(value)
