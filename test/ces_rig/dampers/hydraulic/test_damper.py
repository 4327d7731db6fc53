"""Damper descriptions: the packaged file holds the defaults, parts may be given alone, mistakes cost one clear line."""

from importlib.resources import files
from pathlib import Path

from bench.parameter_table import as_yaml, rows
from ces_rig.dampers.hydraulic.parameters import Damper, coefficients, load_damper, parse_damper

PACKAGED = Path(str(files("ces_rig.dampers.hydraulic"))) / "damper.yaml"


def test_the_packaged_file_is_the_default_damper():
    assert load_damper(PACKAGED) == Damper()
    assert PACKAGED.read_text(encoding="utf-8") == as_yaml()


def test_one_key_of_a_check_valve_may_be_given_alone():
    damper = parse_damper({"top_checks": {"compression": {"closing_s": 0.004}}}, "x")
    assert damper.top_checks.compression.closing_s == 0.004
    assert damper.top_checks.compression.area_m2 == Damper().top_checks.compression.area_m2
    assert damper.piston == Damper().piston


def test_every_parameter_reaches_the_kernel():
    base = coefficients(Damper())
    special = {"half_stroke_m", "start_degC"}  # start: in the state; half stroke: below
    for path, default, one in rows():
        if path.rpartition(".")[2] in special:
            continue
        mapping = default * 1.01 if default else 0.5 * one.high
        for key in reversed(path.split(".")):
            mapping = {key: mapping}
        assert coefficients(parse_damper(mapping, "x")) != base, path
    assert coefficients(parse_damper({"body": {"half_stroke_m": 0.05}}, "x")) != base


def test_every_parameter_has_a_unit_and_lies_inside_its_range():
    for path, value, one in rows():
        assert one.unit and one.meaning and one.low <= value <= one.high, path


def test_words_that_are_numbers_are_taken(tmp_path):
    path = tmp_path / "d.yaml"
    path.write_text("reservoir: {pressure_Pa: 8e5}\n")  # YAML 1.1 reads 8e5 as a word
    assert load_damper(path).reservoir.pressure_Pa == 8e5
