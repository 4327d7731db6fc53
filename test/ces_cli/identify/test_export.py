"""`ces export` from a model file to C files that compile, and its one-line errors."""

import json
import subprocess
import zipfile
from xml.etree import ElementTree

import pytest
from hydraulic_models import GROOVE, hydraulic_model, make_hydraulic
from physical_examples import make_valve
from samplings import make_sampling

from ces_cli.main import main
from ces_observer.model import Envelope, Model, load_model
from ces_observer.structures.polynomial import Factor, Polynomial, Term

SPEED = Factor("speed", 0)
FIRST = Factor("force", 1)


def model_file(path, past=0.8, delay_s=0.0):
    """Write a model."""
    terms = (Term(past, (FIRST,)), Term(900.0, (SPEED,)), Term(100.0, (SPEED, Factor("current", 3))))
    envelope = Envelope((-0.1, 0.1), (-2.0, 2.0), (0.0, 2.0))
    model = Model(make_sampling(outlier_m=0.02, delay_s=delay_s), Polynomial(terms), envelope, (-3e4, 3e4))
    model.save(path)
    return path


def export(*words):
    return main(["export", *(str(word) for word in words)])


def error_line(capsys, *words):
    """Run a program that must fail; return its error line."""
    assert export(*words) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("ces export: error: ")
    return lines[0]


def test_two_files_with_the_name_of_out_and_the_core(tmp_path, capsys):
    assert export(model_file(tmp_path / "m.json"), "--out", tmp_path / "Rear-Damper.c") == 0
    printed = capsys.readouterr().out
    assert "rear_damper_step and rear_damper_tick, 3 terms" in printed
    assert "stable: contraction: the gains of the past forces sum to at most 0.800 < 1" in printed
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        *("Rear-Damper.c", "Rear-Damper.h", "ces_core.c", "ces_core.h", "m.json")
    ]
    assert '#include "Rear-Damper.h"' in (tmp_path / "Rear-Damper.c").read_text()
    assert "Bounds: gain " in (tmp_path / "Rear-Damper.h").read_text()


@pytest.mark.needs("cc")
def test_a_chosen_name_compiles(tmp_path):
    assert export(model_file(tmp_path / "m.json"), "--out", tmp_path / "a.c", "--name", "LeftRear") == 0
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
    (tmp_path / "main.c").write_text(
        '#include "a.h"\n'
        "int main(void)\n{\n    LeftRear_state state;\n    double force_N;\n    LeftRear_reset(&state);\n"
        "    return LeftRear_step(&state, 0, 0.0, 0.5, &force_N) == LEFTREAR_WARMING_UP ? 0 : 1;\n}\n"
    )
    subprocess.run(["cc", *strict, "-o", "run", "a.c", "ces_core.c", "main.c", "-lm"], cwd=tmp_path, check=True)
    subprocess.run([tmp_path / "run"], check=True)


def test_an_unstable_model_needs_an_option_and_gives_a_warning(tmp_path, capsys):
    words = (model_file(tmp_path / "m.json", past=1.01), "--out", tmp_path / "m.c")
    assert "cannot be proved (the gains of the past forces may sum to 1.01; expected" in error_line(capsys, *words)
    assert not (tmp_path / "m.c").exists()
    assert export(*words, "--allow-uncertified") == 0
    assert "warning: --allow-uncertified" in capsys.readouterr().err
    assert "NOT PROVED" in (tmp_path / "m.h").read_text()


def test_the_header_of_a_model_with_a_delay_says_when_its_estimates_come(tmp_path):
    assert export(model_file(tmp_path / "m.json", delay_s=0.003), "--out", tmp_path / "m.c") == 0
    header = (tmp_path / "m.h").read_text()
    assert "#define M_DELAY_TICKS 3U" in header
    assert "Returns M_OK if there are forces of earlier samples" in header


def test_the_certificate_in_the_file_is_not_trusted(tmp_path, capsys):
    path = model_file(tmp_path / "m.json", past=1.01)
    path.write_text(json.dumps({**json.loads(path.read_text()), "certificate": {"gain": 0.5}}))
    assert "cannot be proved" in error_line(capsys, path, "--out", tmp_path / "m.c")


def test_a_hydraulic_network_states_both_bounds(tmp_path, capsys):
    structure = make_hydraulic(make_valve(), bypass=GROOVE)
    model = hydraulic_model(structure)
    model.save(tmp_path / "m.json")
    proof = model.certify()
    bounds = f"|force| at most {proof.envelope_N:.0f} N within the envelope, {proof.force_bound_N:.0f} N for any input"
    assert export(tmp_path / "m.json", "--out", tmp_path / "m.c") == 0
    assert export(tmp_path / "m.json", "--out", tmp_path / "m.fmu", "--sources-only") == 0
    assert capsys.readouterr().out.count(bounds) == 2
    assert structure.size in (tmp_path / "m.h").read_text()
    with zipfile.ZipFile(tmp_path / "m.fmu") as archive:
        description = ElementTree.fromstring(archive.read("modelDescription.xml")).get("description")
        assert archive.read("sources/m.c").decode() == (tmp_path / "m.c").read_text()
    assert bounds in description
    assert structure.size in description


@pytest.mark.needs("cc")
def test_an_fmu_by_its_suffix(tmp_path, capsys):
    assert export(model_file(tmp_path / "m.json"), "--out", tmp_path / "Rear-Damper.fmu") == 0
    printed = capsys.readouterr().out
    assert "Rear-Damper.fmu: FMI 2.0 co-simulation rear_damper, 3 terms, binaries/" in printed
    assert "stable: contraction: the gains of the past forces sum to at most 0.800 < 1" in printed
    with zipfile.ZipFile(tmp_path / "Rear-Damper.fmu") as archive:
        names = set(archive.namelist())
    files = ("rear_damper.c", "rear_damper.h", "ces_core.c", "ces_core.h", "fmi2_rear_damper.c", "BUILD.txt")
    sources = {f"sources/{name}" for name in files}
    assert names > sources | {"modelDescription.xml"}
    assert any(name.startswith("binaries/") for name in names)


def test_an_fmu_without_a_compiler_needs_an_option(tmp_path, capsys, monkeypatch):
    words = (model_file(tmp_path / "m.json"), "--out", tmp_path / "m.fmu")
    monkeypatch.setenv("CC", "no-such-compiler")
    problem = "CC=no-such-compiler is not found; install one (sudo apt install gcc), or give --sources-only"
    assert problem in error_line(capsys, *words)
    assert not (tmp_path / "m.fmu").exists()
    assert export(*words, "--sources-only") == 0
    assert "sources only" in capsys.readouterr().out


def test_a_flat_file_by_its_suffix(tmp_path, capsys):
    words = (model_file(tmp_path / "m.json"), "--out", tmp_path / "rear-damper.ces")
    assert export(*words) == 0
    assert "rear-damper.ces: flat file rear_damper, 3 terms, " in capsys.readouterr().out
    lines = (tmp_path / "rear-damper.ces").read_bytes().split(b"\n")
    assert f"model={load_model(tmp_path / 'm.json').digest()}".encode() in lines
    assert {b"name=rear_damper", b"proved=1", b"delay_s=0.0"} <= set(lines)
    assert "exists; choose another name" in error_line(capsys, *words)
    assert export(*words, "--overwrite") == 0


def test_the_core_beside_the_c_is_shared_by_models(tmp_path):
    for name in ("front", "rear"):
        assert export(model_file(tmp_path / "m.json"), "--out", tmp_path / f"{name}.c") == 0
    files = ["ces_core.c", "ces_core.h", "front.c", "front.h", "m.json", "rear.c", "rear.h"]
    assert sorted(path.name for path in tmp_path.iterdir()) == files
