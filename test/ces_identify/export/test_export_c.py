"""The exported C is the estimator's twin: compiled without a warning, the same forces and reasons on rough input."""

import ctypes
import math
import random
import shutil
import struct
import subprocess

import numpy as np
import pytest
from constructed_models import TERMS as CONSTRUCTED
from trained_models import fuzzy_model

from ces_identify.export.c_text import number
from ces_identify.export.export_c import LONGEST_NAME, NAME_ENDING, REASONS, export_c, identifier
from ces_observer.errors import ModelError
from ces_observer.estimator import Estimator
from ces_observer.model import Envelope, Model, Sampling
from ces_observer.proof.certificate import Contraction
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-O2", "-Werror"]
CODES = {reason: code for code, reason in enumerate(REASONS.values())}
UNPROVED = Contraction(2.0, 1.0, 1, "", "")
COUNT = 2000
MS = 1_000_000
HARNESS = """
#include "model.h"
#include <string.h>

void steps(int64_t n, const int64_t *stamps, const double *positions, const double *currents,
           double *out, int32_t *reasons)
{
    model_state state;
    memset(&state, 0x01, sizeof state); /* reset has to set everything */
    model_reset(&state);
    for (int64_t i = 0; i < n; i++) {
        reasons[i] = (int32_t)model_step(&state, stamps[i], positions[i], currents[i], &out[4 * i]);
        out[4 * i + 1] = state.position_m;
        out[4 * i + 2] = state.speed_m_s;
        out[4 * i + 3] = state.past.clamped ? 1.0 : 0.0;
    }
}

void ticks(int64_t n, const double *positions, const double *speeds, const double *currents, double *forces)
{
    model_past past;
    memset(&past, 0x01, sizeof past);
    model_past_reset(&past);
    for (int64_t i = 0; i < n; i++) {
        if (model_tick(&past, positions[i], speeds[i], currents[i], &forces[i]) != MODEL_OK) {
            model_past_reset(&past);
        }
    }
}
"""

compiler = shutil.which("cc")
needs_compiler = pytest.mark.skipif(compiler is None, reason="no C compiler (cc) on this machine")


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
}


# ---------------------------------------------------------------------------------------------------------- inputs


def stroke(stamps):
    t = (stamps - stamps[0]) * 1e-9
    return 0.012 * np.sin(25.0 * t) + 0.004 * np.sin(90.0 * t + 1.0)


def steady(dice, interval_ns=MS, jitter_ns=0.0):
    stamps = 10**18 + np.arange(COUNT) * interval_ns + np.rint(dice.uniform(-jitter_ns, jitter_ns, COUNT)).astype(int)
    position = stroke(stamps) + dice.normal(0, 15e-6, COUNT)
    return stamps, position, 0.5 + 0.3 * np.sin(stamps * 4e-9)


def jittered(dice):
    return steady(dice, jitter_ns=0.45 * MS)


def gapped(dice):
    stamps, _, current = jittered(dice)
    for at, gap_ms in ((400, 49), (900, 60), (1000, 5), (1300, 20_000)):
        stamps[at:] += gap_ms * MS
    kept = dice.random(COUNT) > 0.1
    return stamps[kept], stroke(stamps)[kept], current[kept]


def not_finite(dice):
    stamps, position, current = jittered(dice)
    for values in (position, current):
        values[dice.choice(COUNT, 100, replace=False)] = dice.choice([np.nan, np.inf, -np.inf], 100)
    position[:5] = np.nan
    position[1000:1080] = np.nan
    return stamps, position, current


def outliers(dice):
    stamps, position, current = jittered(dice)
    position[dice.choice(COUNT, 60, replace=False)] += 0.05
    position[700:709] -= 0.1
    position[950:960] += 0.2
    position[1150:1161] += 0.2
    position[1400:] += 0.03
    position[1800] = 1e308
    return stamps, position, current


def late(dice):
    stamps, position, current = jittered(dice)
    for at in dice.choice(np.arange(10, COUNT), 80, replace=False):
        stamps[at] = stamps[at - dice.integers(1, 9)]
    stamps[800] -= 2_000 * MS
    stamps[1400:] -= 5_000 * MS
    return stamps, position, current


def slow(dice):
    return steady(dice, interval_ns=4_100_000)


def fast(dice):
    return steady(dice, interval_ns=301_000, jitter_ns=100_000)


def wide(dice):
    stamps, position, current = jittered(dice)
    return stamps, 2.0 * position, 3.0 * (current - 0.3)


def at_rest(dice):
    stamps, position, current = steady(dice)
    position[:] = 0.0
    position[1000:] = -0.0
    return stamps, position, current


def half_ticks(dice):
    """Samples exactly between two ticks of the model that ticks every 2^20 ns, where rounding decides."""
    return steady(dice, interval_ns=2**19)


def edges(dice):
    """A clock that starts at zero, a position just not an outlier, a gap just not too long and one that is."""
    stamps, position, current = steady(dice)
    stamps -= stamps[0]
    position[:2] = [0.0, 0.004]
    stamps[1000:] += 49 * MS
    stamps[1200:] += 49 * MS + 1
    return stamps, position, current


def lost_rows(dice):
    """A fast stroke of which rows of up to 60 samples are lost, with wrong positions straight after some."""
    stamps, _, current = jittered(dice)
    position, kept, at = 6.0 * stroke(stamps), np.ones(COUNT, bool), 150
    while at < COUNT - 100:
        lost = dice.integers(1, 61)
        kept[at : at + lost] = False
        position[at + lost] += dice.choice([0.0, 0.0, 0.01, 0.05, 0.4, -0.2])
        at += lost + dice.integers(2, 60)
    return stamps[kept], position[kept], current[kept]


def ends_of_time(dice):
    stamps, position, current = steady(dice)
    first, last = np.iinfo(np.int64).min, np.iinfo(np.int64).max
    stamps[:1000] = first + np.arange(1000) * MS
    stamps[1000:1010] = [first, last, 0, first, -1, 0, 1, last, last - 1, first]
    stamps[1400:] = last - np.arange(COUNT - 1400)[::-1] * MS
    return stamps, position, current


def all_at_once(dice):
    stamps, position, current = outliers(dice)
    stamps[600:] += 70 * MS
    stamps[1200:] -= 400 * MS
    current[dice.choice(COUNT, 50, replace=False)] = np.nan
    kept = dice.random(COUNT) > 0.05
    return stamps[kept], position[kept], 2.0 * current[kept]


INPUTS = [
    *(steady, jittered, gapped, not_finite, outliers, late, slow, fast),
    *(wide, at_rest, half_ticks, edges, lost_rows, ends_of_time, all_at_once),
]


# ------------------------------------------------------------------------------------------------------------ twins


def compile_c(folder, model, certificate=UNPROVED):
    source, header = export_c(model, "model", "model", certificate)
    for name, text in (("model.c", source), ("model.h", header), ("harness.c", HARNESS)):
        (folder / name).write_text(text, encoding="ascii")
    run = [compiler, *STRICT, "-fPIC", "-shared", "-o", "model.so", "model.c", "harness.c", "-lm"]
    done = subprocess.run(run, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return ctypes.CDLL(str(folder / "model.so"))


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Return the compiled library of a model of MODELS, by its name."""
    ready = {}

    def find(name):
        if name not in ready:
            ready[name] = compile_c(tmp_path_factory.mktemp("model"), MODELS[name])
        return ready[name]

    return find


def pointers(*arrays):
    return [ctypes.c_void_p(a.ctypes.data) for a in arrays]


def c_steps(library, stamps, position, current):
    """Return rows (n, 4) of force, position, speed and clamped, and reasons (n,)."""
    arrays = [np.ascontiguousarray(a, kind) for a, kind in ((stamps, np.int64), (position, float), (current, float))]
    rows, reasons = np.full((len(stamps), 4), 1e9), np.full(len(stamps), -1, np.int32)
    library.steps(ctypes.c_int64(len(stamps)), *pointers(*arrays, rows, reasons))
    return rows, reasons


def python_steps(model, stamps, position, current):
    e, rows, reasons = Estimator(model), [], []
    for sample in zip(stamps.tolist(), position.tolist(), current.tolist(), strict=True):
        force = e.step(*sample)
        rows.append((math.nan if force is None else force, e.position, e.speed, e.clamped))
        reasons.append(CODES[e.reason])
    return np.array(rows, float), np.array(reasons)


def seeded(shape):
    return shape(np.random.default_rng(INPUTS.index(shape)))


@needs_compiler
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


@needs_compiler
def test_the_inputs_above_reach_every_reason(library):
    reached = {name: set() for name in MODELS}
    for name in ("plain, order 3", "unstable"):
        for shape in INPUTS:
            reached[name] |= set(c_steps(library(name), *seeded(shape))[1].tolist())
    assert reached["plain, order 3"] == set(CODES.values()) - {CODES["force left its envelope"]}
    assert reached["unstable"] == set(CODES.values())


@needs_compiler
@pytest.mark.parametrize("name", MODELS)
def test_a_tick_is_the_polynomials(library, name):
    dice = np.random.default_rng(7)
    inputs = [dice.normal(0, spread, COUNT) + mean for mean, spread in ((0, 0.01), (0, 0.8), (0.5, 0.3))]
    inputs[1][::50] = 0.0
    inputs[1][25::50] = np.nan
    forces = np.empty(COUNT)
    library(name).ticks(ctypes.c_int64(COUNT), *pointers(*inputs, forces))
    polynomial, expected = MODELS[name].make_predictor(), []
    for row in zip(*(values.tolist() for values in inputs), strict=True):
        expected.append(polynomial.tick(*row))
        if math.isinf(expected[-1]):
            expected[-1] = math.nan
            polynomial.reset()
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(forces, expected, rtol=1e-9, atol=1e-9)


# ------------------------------------------------------------------------------------------------------- the text


@needs_compiler
@pytest.mark.skipif(shutil.which("nm") is None, reason="no nm on this machine")
@pytest.mark.parametrize("name", ["plain, order 3", "powers"])
def test_it_needs_nothing_but_math_and_has_no_globals(tmp_path, name):
    compile_c(tmp_path, MODELS[name])
    subprocess.run([compiler, *STRICT, "-c", "model.c"], cwd=tmp_path, check=True)
    listing = subprocess.run(["nm", "model.o"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    kinds = {line.split()[-1]: line.split()[-2] for line in listing.splitlines()}
    assert {n for n, kind in kinds.items() if kind == "U"} <= {"cos", "exp", "floor", "pow", "sqrt"}
    assert not {n for n, kind in kinds.items() if kind in "bBdDC"}
    assert {n for n, kind in kinds.items() if kind == "T"} == {
        "model_reset", "model_step", "model_tick", "model_past_reset"
    }  # fmt: skip


@needs_compiler
def test_numbers_read_back_exactly(tmp_path):
    dice = random.Random(3)
    values = [5e-324, 1.7976931348623157e308, -0.0, 0.1, 1e22, 1e23, 1.0, -7.0]
    values += [struct.unpack("d", dice.randbytes(8))[0] for _ in range(2000)]
    values = [v for v in values if math.isfinite(v)]
    text = f"const double values[] = {{{', '.join(map(number, values))}}};\n"
    (tmp_path / "values.c").write_text(text)
    subprocess.run([compiler, "-std=c99", "-fPIC", "-shared", "-o", "v.so", "values.c"], cwd=tmp_path, check=True)
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


def test_other_structures_are_refused():
    with pytest.raises(ModelError, match="structure is anfis; only polynomial_narx"):
        export_c(fuzzy_model(), "model", "model", UNPROVED)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_numbers_that_are_not_finite_are_refused(value):
    with pytest.raises(ModelError, match="finite"):
        number(value)
