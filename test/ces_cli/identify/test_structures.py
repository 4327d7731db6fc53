import argparse
import inspect

import pytest

from ces_cli.identify.structures import add_structure, select_identify_function
from ces_identify.identification import identify
from ces_identify.structures.fuzzy import FuzzyShape
from ces_identify.structures.network import NetworkShape
from ces_identify.structures.polynomial import fit_polynomial


def select_from(*arguments):
    parser = argparse.ArgumentParser(exit_on_error=False)
    add_structure(parser)
    return select_identify_function(parser.parse_args(arguments))


def fitter_in(selected):
    """The structure's own fitter, around which others are fitted shortly for comparison."""
    return inspect.getclosurevars(selected.keywords["fitter"]).nonlocals["fitter"]


def test_each_structure_has_its_fitter():
    default = select_from()
    network, anfis = (
        select_from("--structure", "sigmoid", "--units", "6"),
        select_from("--structure", "anfis", "--rules", "5x3"),
    )
    assert default.func is network.func is anfis.func is identify
    assert fitter_in(default) is fit_polynomial
    assert fitter_in(network) == NetworkShape(units=6)
    assert fitter_in(anfis) == FuzzyShape(speeds=5, currents=3)
    assert fitter_in(select_from("--structure", "anfis")) == FuzzyShape()


@pytest.mark.parametrize(
    ("text", "message"),
    [("7", "not VxI"), ("1x2", "at least 2"), ("axb", "not VxI"), ("-3x2", "not VxI"), ("20x4", "makes 80 rules")],
)
def test_an_invalid_grid_is_refused(text, message):
    with pytest.raises(argparse.ArgumentError, match=message):
        select_from(f"--rules={text}")
