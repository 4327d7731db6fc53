import argparse
import inspect

import pytest

from ces_cli.identify.program import select_identify_function
from ces_cli.terminal.terminal import add_options
from ces_identify.identification import identify
from ces_identify.options import list_options
from ces_identify.structures.auto import BestStructure
from ces_identify.structures.fuzzy import CURRENT_AND_SPEED, FuzzyShape
from ces_identify.structures.network import NetworkShape
from ces_identify.structures.polynomial import fit_polynomial
from ces_identify.trained.training import LagCounts
from ces_observer.errors import CesError


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


def test_lags_and_memberships_are_as_in_the_thesis():
    network = select_from("--structure", "sigmoid", "--units", "30", "--lags", "2,4,5")
    assert fitter_in(network) == NetworkShape(30, LagCounts(forces=2, currents=4, speeds=5))
    anfis = select_from("--structure", "anfis", "--memberships", "3x6")
    assert fitter_in(anfis) == FuzzyShape(6, 3, 0.0, CURRENT_AND_SPEED)
    with pytest.raises(CesError, match="--rules 5x2 and --memberships 4x4: give one"):
        select_from("--structure", "anfis", "--memberships", "4x4", "--rules", "5x2")
