"""The front and the recommendation, by selection cost alone."""

from hypothesis import given
from hypothesis import strategies as st

from ces_identify.campaign.cells import front, is_proved, recommend_model
from ces_identify.jobs import DONE, FAILED
from ces_identify.limits import ChoiceLimits


def row(parameters, cost, gain=0.5, status=DONE, validation=1.0, bound_N=900.0):
    costs = [{"set": "road", "J": validation}]
    proof = {"gain": gain, "force_bound_N": bound_N}
    return {"parameters": parameters, "selection_J": cost, **proof, "status": status, "costs": costs}


def sizes(rows):
    return [r["parameters"] for r in rows]


def test_validation_costs_choose_nothing():
    rows = [row(4, 5.0, validation=0.1), row(8, 2.0, validation=90.0)]
    assert recommend_model(rows)["parameters"] == 8


def test_the_smallest_within_a_tenth_is_recommended():
    assert recommend_model([row(4, 2.3), row(6, 2.19), row(20, 2.0)])["parameters"] == 6


def test_models_without_proof_count_only_if_none_has_one():
    assert sizes(front([row(4, 1.0, bound_N=None), row(6, 2.0)])) == [6]
    assert sizes(front([row(4, 1.0, bound_N=None), row(6, 2.0, bound_N=None)])) == [4]


def test_a_proof_without_a_gain_is_a_proof():
    passive = row(4, 1.0, gain=None)
    assert is_proved(passive) and not is_proved(row(4, 1.0, gain=None, bound_N=None))
    assert sizes(front([passive, row(6, 0.9)])) == [4, 6]


def test_failed_and_diverged_cells_are_left_out():
    assert front([{"status": FAILED}, row(4, None)]) == []
    assert recommend_model([]) is None


@given(st.lists(st.tuples(st.integers(1, 30), st.floats(0.1, 100.0)), min_size=1))
def test_nothing_beats_the_front_and_the_front_beats_the_rest(points):
    rows = [row(*point) for point in points]
    best = front(rows)
    for r in rows:
        better = [b for b in best if b["parameters"] <= r["parameters"] and b["selection_J"] <= r["selection_J"]]
        assert better
        if r in best:
            assert better == [r]
    chosen = recommend_model(rows)["selection_J"]
    assert chosen <= (1.0 + ChoiceLimits.COST_TOLERANCE) * min(r["selection_J"] for r in rows)
