"""What a user of the exported C sees: files, names, comments, and C99 that any compiler takes without a warning."""

import ctypes
import math
import random
import re
import struct
import subprocess
from dataclasses import replace

import pytest
from exported_models import MODELS, PLAIN, make
from tick_forms import STRICT, UNPROVED

from ces_identify.export.export_model import CODES, LONGEST_NAME, NAME_ENDING, _table, export_c, identifier
from ces_observer.errors import ModelError
from ces_observer.model import Model, parse_model
from ces_observer.reasons import REASONS
from ces_observer.structures.polynomial import Polynomial
from ces_observer.tick.tracker import RESTARTED

NAMES = ["plain, with a band", "a delay, measured acceleration", "hydraulic", "rules", "recurrent"]


def write(folder, model, name="model"):
    """Write a model's files; return the names of those in C."""
    files = export_c(model, name, name, UNPROVED)
    for path, text in files.items():
        (folder / path).write_text(text, encoding="ascii")
    return [path for path in files if path.endswith(".c")]


def cc(folder, *words, compiler="cc"):
    done = subprocess.run([compiler, *words], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.needs("cc", "c++", "nm")
@pytest.mark.parametrize("name", NAMES)
def test_it_compiles_strictly_and_needs_nothing_but_math_and_no_globals(tmp_path, name):
    files = write(tmp_path, MODELS[name]())
    cc(tmp_path, *STRICT, "-Os", "-c", *files)
    (tmp_path / "user.cpp").write_text(
        '#include "model.h"\nint use(model_state &s) { model_reset(&s); return MODEL_OK; }\n'
    )
    cc(tmp_path, "-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-c", "user.cpp", compiler="c++")
    kinds = {}
    for file in ("model.o", "ces_core.o"):
        listing = subprocess.run(["nm", file], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
        kinds[file] = {line.split()[-1]: line.split()[-2] for line in listing.splitlines()}
    undefined = {n for n, kind in (*kinds["model.o"].items(), *kinds["ces_core.o"].items()) if kind == "U"}
    public = {n for n, kind in kinds["model.o"].items() if kind == "T"}
    math_names = {"cos", "exp", "floor", "fmax", "fmin", "log", "pow", "sin", "sqrt", "tanh"}
    assert {n for n in undefined if not n.startswith("ces_")} <= math_names | {
        "memcpy",
        "memset",
        "_GLOBAL_OFFSET_TABLE_",
    }
    assert not {n for of in kinds.values() for n, kind in of.items() if kind in "bBdDC"}
    assert public - {"model_half_width"} == {"model_reset", "model_step", "model_tick", "model_past_reset"}
    assert all(n.startswith("ces_") for n, kind in kinds["ces_core.o"].items() if kind == "T")


@pytest.mark.needs("cc")
def test_two_models_of_different_structures_share_the_core(tmp_path):
    files = {*write(tmp_path, MODELS["plain"](), "front"), *write(tmp_path, MODELS["network"](), "rear")}
    assert files == {"front.c", "rear.c", "ces_core.c"}
    (tmp_path / "main.c").write_text(
        '#include "front.h"\n#include "rear.h"\nint main(void)\n{\n    static front_state front;\n'
        "    static rear_state rear;\n    double force_N;\n    front_reset(&front);\n    rear_reset(&rear);\n"
        "    return (int)front_step(&front, 0, 0.0, 0.5, &force_N) + (int)rear_step(&rear, 0, 0.0, 0.5, &force_N);\n}\n"
    )
    cc(tmp_path, *STRICT, "-o", "run", "main.c", *files, "-lm")
    assert subprocess.run([tmp_path / "run"], check=False).returncode == 2 * CODES["WARMING_UP"][0]


@pytest.mark.needs("cc")
def test_a_core_of_another_version_is_refused_by_the_compiler(tmp_path):
    write(tmp_path, MODELS["plain"]())
    header = tmp_path / "ces_core.h"
    header.write_text(re.sub("(?<=CES_CORE_DIGEST 0x)....", "1234", header.read_text()))
    done = subprocess.run(["cc", "-c", "model.c"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "another version of ces_observer than this file: export all models again" in done.stderr


@pytest.mark.parametrize("name", ["plain, with a band", "a delay", "rules", "hydraulic"])
def test_a_model_file_gives_the_same_code(name):
    model = MODELS[name]()
    code = export_c(model, "m", "m", UNPROVED)
    assert list(code) == ["m.c", "m.h", "ces_core.c", "ces_core.h"]
    assert export_c(parse_model(model.to_json(), "model.json"), "m", "m", UNPROVED) == code
    assert ("m_half_width" in code["m.h"]) == (model.band is not None and not model.sampling.delay_s)
    assert ("m_estimate" in code["m.h"]) == (model.sampling.delay_s > 0.0)


def test_the_reasons_are_the_estimators():
    assert [code for code, _ in CODES.values()] == list(range(RESTARTED))
    assert [text for _, text in CODES.values()] == list(REASONS[:RESTARTED])


@pytest.mark.needs("cc")
def test_numbers_read_back_exactly(tmp_path):
    dice = random.Random(3)
    values = [5e-324, 1.7976931348623157e308, -0.0, 0.1, 1e22, 1e23, 1.0, -7.0]
    values += [struct.unpack("d", dice.randbytes(8))[0] for _ in range(2000)]
    values = [v for v in values if math.isfinite(v)]
    (tmp_path / "values.c").write_text(_table("const double values", values))
    cc(tmp_path, "-std=c99", "-fPIC", "-shared", "-o", "v.so", "values.c")
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
    code = export_c(model, "model", "model", model.certify())
    assert "hostile" not in "".join(code.values())
    assert all(model.digest() in code[name] for name in ("model.c", "model.h"))


@pytest.mark.parametrize("name", ["plain", "hydraulic", "recurrent"])
def test_the_header_states_the_proof_and_what_becomes_of_inputs(name):
    model = replace(MODELS[name](), force_envelope_N=(-1e5, 1e5))
    proof = model.certify()
    assert proof.holds
    header = export_c(model, "model", "model", proof)["model.h"]
    words = " ".join(header.replace("\n *", " ").split())
    assert "Stability: proved at export." in words
    assert proof.claim in words
    assert all(f"{key} {value!r}" in words for key, value in proof.bounds.items())
    assert f"They are {model.body.outside}." in words
    assert "NOT PROVED" not in header
    assert "NOT PROVED" in export_c(model, "model", "model", UNPROVED)["model.h"]


def test_a_number_that_is_not_finite_is_refused():
    model = replace(make(*PLAIN), sampling=replace(make(*PLAIN).sampling, outlier_m=math.inf))
    with pytest.raises(ModelError, match="finite"):
        export_c(model, "model", "model", UNPROVED)


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
        ("ces", "model", "is the core's"),
        ("model", 'a"b', "file name"),
        ("model", "math", "standard header"),
        ("model", "ces_core", "file name"),
    ],
)
def test_names_that_c_cannot_bear_are_refused(name, stem, message):
    with pytest.raises(ModelError, match=message):
        export_c(make(*PLAIN), name, stem, UNPROVED)
