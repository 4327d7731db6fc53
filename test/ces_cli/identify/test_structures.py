import argparse

import pytest

from ces_cli.identify.structures import add_structure, grid, identifier
from ces_identify.identify import identify
from ces_identify.identify_trained import identify_anfis, identify_network
from ces_identify.trained.fuzzy_structure import FuzzyShape
from ces_identify.trained.network_structure import NetworkShape


def chosen(*arguments):
    parser = argparse.ArgumentParser()
    add_structure(parser)
    return identifier(parser.parse_args(arguments))


def test_each_structure_has_its_identification():
    assert chosen() is identify
    network, anfis = chosen("--structure", "sigmoid", "--units", "6"), chosen("--structure", "anfis", "--rules", "5x3")
    assert (network.func, network.keywords) == (identify_network, {"shape": NetworkShape(units=6)})
    assert (anfis.func, anfis.keywords) == (identify_anfis, {"shape": FuzzyShape(speeds=5, currents=3)})


@pytest.mark.parametrize(
    ("text", "message"),
    [("7", "not VxI"), ("1x2", "at least 2"), ("axb", "not VxI"), ("-3x2", "not VxI"), ("20x4", "makes 80 rules")],
)
def test_a_grid_that_makes_no_sense_is_refused(text, message):
    with pytest.raises(argparse.ArgumentTypeError, match=message):
        grid(text)
