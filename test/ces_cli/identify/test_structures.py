import argparse
import inspect

from ces_cli.identify.program import select_identify_function
from ces_cli.terminal.terminal import add_options
from ces_identify.identification import identify
from ces_identify.options import list_options
from ces_identify.structures.auto import BestStructure
from ces_identify.structures.fuzzy import FuzzyShape
from ces_identify.structures.network import NetworkShape
from ces_identify.structures.polynomial import fit_polynomial


def select_from(*arguments):
    parser = argparse.ArgumentParser(exit_on_error=False)
    add_options(parser, *list_options())
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
    assert isinstance(select_from("--structure", "auto").keywords["fitter"], BestStructure)
