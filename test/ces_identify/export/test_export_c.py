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
from exported_c import (
    CODES,
    INPUTS,
    UNPROVED,
    a_million_samples,
    assert_same,
    c_steps,
    c_ticks,
    compile_c,
    half_ticks,
    hostile,
    python_steps,
    python_ticks,
    seeded,
    stroke,
    two_models,
    undefined_and_defined,
)
from exported_models import LAGS, MODELS, PLAIN, POWERS, make

from ces_identify.export.export_c import AT_FILE_SCOPE, LONGEST_NAME, NAME_ENDING, export_c, identifier
from ces_identify.structures.kit import number
from ces_observer.errors import ModelError
from ces_observer.estimator import UNBOUNDED
from ces_observer.model import Model, parse_model
from ces_observer.structures.hydraulic import Hydraulic
from ces_observer.structures.polynomial import Polynomial

ALL_INPUTS = {"plain", "measured acceleration", "overflowing", "network", "hydraulic", "a delay", "two models"}


def inputs_of(name):
    """Return all inputs for a few models, the worst and three drawn ones for the others."""
    return INPUTS if name in ALL_INPUTS else [INPUTS[-1], half_ticks, *random.Random(name).sample(INPUTS[:-1], 3)]


def tolerance(model):
    """Return what forces may differ by [N]: the steps of a physical model are solved to a share of its largest."""
    return 1e-9 * (model.force_envelope_N[1] if isinstance(model.body, Hydraulic) else 1.0)


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
        found, expected = c_steps(compiled, *samples), python_steps(model, *samples)
        assert_same(found, expected, tolerance(model), shape.__name__)
        if model.sampling.delay_s:
            assert np.isnan(found.rows[:, 0]).all()
        else:
            np.testing.assert_array_equal(np.isnan(found.rows[:, 0]), found.reasons != CODES["ok"], shape.__name__)


@pytest.mark.slow
@pytest.mark.needs("cc")
def test_the_inputs_above_reach_every_reason(library) -> None:
    reached = {
        name: {reason for shape in INPUTS for reason in c_steps(library(name)[1], *seeded(shape)).reasons.tolist()}
        for name in ("plain", "overflowing", "a delay", "a delay, overflowing")
    }
    unbounded = {CODES[UNBOUNDED]}
    assert reached["overflowing"] == reached["a delay, overflowing"] == set(CODES.values())
    assert reached["plain"] == reached["a delay"] == set(CODES.values()) - unbounded


@pytest.mark.needs("cc")
def test_estimates_come_late_by_their_delay_with_the_stamps_of_their_samples(library) -> None:
    stamps, position, current = seeded(INPUTS[0])
    found = c_steps(library("a delay")[1], stamps, position, current)
    first = len(stamps) - len(found.late) - 5  # the last ones are never known
    np.testing.assert_array_equal(found.late_stamps, stamps[first:-5])
    true = np.gradient(stroke(stamps), 1e-3)[first:-5]
    at_once = c_steps(library("plain")[1], stamps, position, current).rows[first:-5, 2]
    assert np.std(found.late[:, 2] - true) < 0.5 * np.std(at_once - true)


@pytest.mark.needs("cc")
def test_the_twins_are_compared_on_forces_and_on_an_unbounded_run(library) -> None:
    moving = c_steps(library("rules")[1], *seeded(INPUTS[0])).rows[:, 0]
    assert np.nanmax(np.abs(moving)) > 20.0
    unstable = c_steps(library("unstable rules")[1], *seeded(INPUTS[0])).rows[:, 0]
    assert np.nanmax(np.abs(unstable)) == 9e3  # held at the end of its envelope


@pytest.mark.slow
@pytest.mark.needs("cc")
def test_a_million_hostile_samples_give_the_same_with_and_without_a_delay(tmp_path_factory) -> None:
    both = two_models(make(*PLAIN), make(*LAGS), 0.003)
    samples = a_million_samples()
    expected = python_steps(both, *samples)
    assert set(expected.reasons.tolist()) == set(CODES.values()) - {CODES[UNBOUNDED]}
    assert len(expected.late) > 300_000
    together, now, late = (
        c_steps(compile_c(tmp_path_factory.mktemp("model"), model), *samples)
        for model in (both, replace(both, delayed=None), both.delayed)
    )
    assert_same(together, expected, 1e-9)
    assert_same(now._replace(late=expected.late, late_stamps=expected.late_stamps), expected, 1e-9)
    assert_same(late._replace(rows=expected.rows, reasons=expected.reasons), expected, 1e-9)


@pytest.mark.slow
@pytest.mark.needs("cc")
@pytest.mark.parametrize("name", MODELS)
def test_a_tick_is_the_structures(library, name) -> None:
    model, compiled = library(name)
    dice = np.random.default_rng(7)
    calm = [dice.normal(0, spread, 1000) + mean for mean, spread in ((0, 0.01), (0, 0.8), (0.5, 0.3))]
    calm[1][::50] = 0.0
    if not isinstance(model.body, Hydraulic):
        calm[1][25::50] = np.nan
    for inputs in (calm, hostile(1000, 1)):
        forces, expected = c_ticks(compiled, *inputs), python_ticks(model, *inputs)
        assert np.isfinite(expected).any()
        np.testing.assert_allclose(forces, expected, rtol=1e-9, atol=tolerance(model))


# ------------------------------------------------------------------------------------------------------- the text


@pytest.mark.slow
@pytest.mark.needs("cc", "nm")
@pytest.mark.parametrize("name", ["powers", "network", "rules", "hydraulic", "two hydraulic models"])
def test_it_needs_nothing_but_math_and_has_no_globals(library, name) -> None:
    needed, kinds = undefined_and_defined(Path(library(name)[1]._name).parent)
    assert needed <= {"cos", "exp", "floor", "fmax", "fmin", "pow", "sqrt"}
    assert not {n for n, kind in kinds.items() if kind in "bBdDC"}
    assert {n for n, kind in kinds.items() if kind == "T"} == {
        "model_reset", "model_step", "model_tick", "model_past_reset"
    }  # fmt: skip


@pytest.mark.parametrize("name", ["two models, measured acceleration", "two hydraulic models", "rules", "a delay"])
def test_no_name_in_the_file_can_be_a_public_one(name) -> None:
    code = "".join(export_c(MODELS[name](), "model", "model", UNPROVED))
    names = {one for found in AT_FILE_SCOPE.findall(code) for one in found if one}
    public = {one.removeprefix("model_").removeprefix("MODEL_") for one in names if one.lower().startswith("model_")}
    assert {"step", "reset", "state", "run", "bank", "past_reset"} <= public
    own = {one for one in names if not one.lower().startswith("model_")}
    assert not [one for one in own if one.endswith(tuple(f"_{ending}" for ending in public))]


def test_without_a_delay_there_is_nothing_for_one() -> None:
    code = "".join(export_c(make(*PLAIN), "model", "model", UNPROVED)).lower()
    assert not any(word in code for word in ("delay", "late_", "smoothing", "model_waiting"))


@pytest.mark.parametrize("name", ["plain, with a band", "two models", "rules", "hydraulic"])
def test_a_model_file_gives_the_same_code(name) -> None:
    model = MODELS[name]()
    again = parse_model(model.to_json(), "model.json")
    code = export_c(model, "m", "m", UNPROVED)
    assert export_c(again, "m", "m", UNPROVED) == code
    assert ("half_width" in "".join(code)) == any(one.band for one in model.each)


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
