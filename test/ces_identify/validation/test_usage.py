from dataclasses import replace

import numpy as np
from planted import NETWORK, planted
from residual_series import series

from ces_identify.identification import identify
from ces_identify.polynomial.candidates import parse_rules
from ces_identify.polynomial.problem import assemble_problem, estimation_ticks
from ces_identify.polynomial.search_limits import Limits
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.validation.cost_table import usage
from ces_observer.structures.terms import Term

RULES = parse_rules(
    {
        "force": {"lags": [1]},
        "speed": {"lags": [0], "powers": [1.0], "forms": ["signed"]},
        "products": [[], ["speed"], ["force"]],
    },
    "test",
)


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


def test_the_test_seconds_change_nothing_of_the_model():
    """What the rule promises, held: identify twice, the second time with all after the split replaced."""
    one = planted(NETWORK, 3, seconds=8.0)

    def changed(channel):
        late = channel.stamps_ns > one.channel("position").stamps_ns[0] + 6.05e9
        shaken = channel.values + 2e-4 * np.sin(0.3 * np.arange(len(channel)))
        new = shaken if channel.name == "position" else -3.0 * channel.values
        return replace(channel, values=np.where(late, new, channel.values))

    spoiled = replace(one, channels={name: changed(channel) for name, channel in one.channels.items()})
    limits = Limits(terms=2, time=60.0, starts=1, threads=1, rounds=1, method="random")
    first, second = (identify([r], options=IdentifyOptions(0.75, RULES, limits)).model for r in (one, spoiled))
    assert first.body.terms == second.body.terms
    assert first.sampling == second.sampling
    assert first.envelope == second.envelope
    assert first.force_envelope_N == second.force_envelope_N
    assert first.provenance["cost_J_percent"][1] != second.provenance["cost_J_percent"][1]
