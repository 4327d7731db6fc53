import numpy as np
from residual_series import series

from ces_identify.polynomial.problem import assemble_problem, estimation_ticks
from ces_identify.validation.cost_table import usage
from ces_observer.structures.terms import Term


def test_seconds_are_those_the_search_deals():
    """Against what the problem weighs: estimation and selection share the scored ticks, and a test has none of them."""
    one = series(6_000, warm_up=250)
    problem = assemble_problem([one], [Term(1.0, ())])
    np.testing.assert_array_equal(problem.selection > 0.0, one.scored & ~estimation_ticks(one))
    row, test = usage([one.part(0.0, 1.0)], [one.part(0.5, 1.0)])
    assert row["selection_s"] == round((problem.selection > 0.0).sum() / 500.0, 1)
    assert row["estimation_s"] == round((one.scored & estimation_ticks(one)).sum() / 500.0, 1)
    assert row["test_s"] == 0.0
    assert (test["estimation_s"], test["selection_s"], test["test_s"]) == (0.0, 0.0, 5.5)
    assert (test["from_s"], test["to_s"]) == (6.0, 12.0)
