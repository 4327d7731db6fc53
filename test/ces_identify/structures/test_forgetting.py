"""How models forget where they were started is measured, proved, written to the file, and required of a fit."""

from dataclasses import replace

import numpy as np
import pytest
from planted_dampers import planted_model, ride

from ces_identify.identification import require_shown_cost, with_forgetting
from ces_identify.limits import ForgettingLimits
from ces_identify.structures.forgetting import measure_forgetting
from ces_identify.structures.kit import Fitted, IdentifyOptions
from ces_observer.errors import CesError
from ces_observer.limits import ProofLimits
from ces_observer.model import parse_model
from ces_observer.proof.certificate import contraction_s, largest_gain
from ces_observer.structures.hydraulic import NEVER_S

RIDE = ride(1)
MODEL = planted_model("twin tube")


def without_relaxation(model):
    return replace(model, body=replace(model.body, relax_s=NEVER_S))


def test_springs_that_relax_forget_and_those_that_do_not_stay_where_they_were():
    forgets, keeps = (measure_forgetting(one, [RIDE], 5.0) for one in (MODEL, without_relaxation(MODEL)))
    assert forgets.largest < ForgettingLimits.LEFT < keeps.left["rest"]
    assert forgets.settles_s < 1.0


def test_a_certified_model_says_what_it_forgets_and_one_that_does_not_is_refused():
    model = with_forgetting(MODEL, [RIDE], 5.0)
    again = parse_model(model.to_json(), "model.json")
    assert again.certificate["forgets_s"] == pytest.approx(5.0)
    assert again.certificate["forgetting"]["how"] == "measured from 24 pasts"
    assert max(again.certificate["forgetting"]["left_percent"].values()) < 1.0
    with pytest.raises(CesError, match=r"is left after 5 s \(rest\); forget=10"):
        with_forgetting(without_relaxation(MODEL), [RIDE], 5.0)


def test_the_estimator_withholds_forces_until_the_model_has_settled():
    model = replace(MODEL, settles_s=2.0)
    again = parse_model(model.to_json(), "model.json")
    assert (again.warm_up_s, MODEL.warm_up_s) == (2.0, MODEL.sampling.warm_up_s)


def test_a_fit_that_leaves_out_ticks_in_silence_is_caught():
    """The force of half of the ride is that of another damper; the cost that was shown is that of the other half."""
    half = len(RIDE) // 2
    force = replace(RIDE, force=np.where(np.arange(len(RIDE)) < half, RIDE.force, -RIDE.force))
    shown = type("Shown", (), {"cost": 2.0})
    fitted = Fitted(MODEL, [shown], {})
    with pytest.raises(CesError, match=r"the search showed J 2\.00 %, and its model has"):
        require_shown_cost(fitted, [force], IdentifyOptions())


@pytest.mark.parametrize(("gain", "past", "inputs"), [(0.5, 1, 0), (0.97, 2, 8), (0.99, 5, 20)])
def test_a_contraction_forgets_in_the_time_that_follows_from_its_gain(gain, past, inputs):
    ticks = 1000.0 * contraction_s(gain, past, inputs, 1000.0)
    apart = [1.0] * (past + inputs)
    while len(apart) < round(ticks) + past:
        apart.append(gain * apart[-past])
    assert apart[-1] <= ProofLimits.FORGOTTEN
    allowed = largest_gain(1e-3 * ticks, past, inputs, 1000.0)
    assert gain <= allowed < 1.0
    assert contraction_s(allowed * (1.0 - 1e-12), past, inputs, 1000.0) <= 1e-3 * ticks * (1.0 + 1e-9)


def test_a_gain_of_one_forgets_nothing():
    assert contraction_s(1.0, 1, 0, 1000.0) == float("inf")
    assert largest_gain(1e-3, 2, 0, 1000.0) == 0.0
