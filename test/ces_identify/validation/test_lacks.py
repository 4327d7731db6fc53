"""What a model lacks: planted dependences of the error are named, and noise never is."""

from dataclasses import replace

import numpy as np
import pytest
from model_examples import make_model
from residual_series import coloured, evaluation, series

from ces_identify.validation.evaluate import IDENTIFICATION
from ces_identify.validation.lacks import dependences, describe, head_lines
from ces_observer.structures.polynomial import Factor, Term

TICKS = 20_000


def ride(seed=1, ticks=TICKS, **signals):
    """A ride whose measured force is that of a simple damper."""
    recorded = series(ticks, seed, **signals)
    return replace(recorded, force=700.0 * recorded.speed + 400.0 * np.tanh(recorded.speed / 0.1))


def errors(recorded, share, offset_N=0.0):
    """The evaluation of a model that lacks the factor 1 + `share`, and adds some noise of its own."""
    noise = 20.0 * coloured(len(recorded), 0.9, 77)
    measured = replace(recorded, force=recorded.force * (1.0 + share) + offset_N + noise)
    return evaluation(measured, measured.force - recorded.force)


def groove(recorded):
    return -0.5 * np.exp(-((recorded.position / 0.01) ** 2))


def test_a_groove_is_named_with_its_place_and_a_structure_that_knows_it():
    recorded = ride()
    (dependence,) = dependences([errors(recorded, groove(recorded) - groove(recorded).mean())])
    assert dependence.names == ("position",)
    assert dependence.share > 0.7
    low, high, change = min(dependence.regions, key=lambda region: region[2])
    assert low < 0.0 < high
    assert change < -0.15
    text = describe(dependence, make_model(), [errors(recorded, groove(recorded))])
    assert text.startswith(f"The error depends on the stroke: {100 * dependence.share:.0f} % of its energy")
    assert f"{-100 * change:.0f} % below the model's from {1e3 * low:.2g} to {1e3 * high:.2g} mm" in text
    assert text.endswith(
        "'polynomial' as identified does not use it: try --structure hydraulic (it knows a bypass over the stroke) "
        "or auto."
    )


def test_a_model_that_uses_the_stroke_is_not_said_to_ignore_it():
    recorded = ride()
    (dependence,) = dependences([errors(recorded, groove(recorded))])
    body = make_model((Term(1000.0, (Factor("position", 0, 1.0),)), Term(100.0, (Factor("speed", 0, 1.0),))))
    assert "as identified" not in describe(dependence, body, [errors(recorded, groove(recorded))])


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("current", lambda recorded: 8.0 * (recorded.current - 0.5) ** 2 * recorded.force),
        ("speed", lambda recorded: -0.5 * (np.abs(recorded.speed) > 0.7) * recorded.force),
        ("acceleration", lambda recorded: 0.4 * np.tanh(np.diff(recorded.speed, prepend=0.0) / 0.05) * recorded.force),
        ("direction", lambda recorded: 500.0 * (np.abs(recorded.speed) - np.abs(recorded.speed).mean())),
    ],
)
def test_each_quantity_is_named(name, error):
    recorded = ride()
    assert name in dependences([errors(recorded, 0.0, error(recorded))])[0].names


def test_levels_of_the_current_are_named_as_such():
    recorded = ride(current=0.3 * (np.arange(TICKS) // 500 * 7 % 3))
    (dependence,) = dependences([errors(recorded, np.where(recorded.current == 0.3, 0.4, -0.2))])
    assert dependence.names == ("current",)
    assert "above the model's at 0.3 A" in describe(dependence, make_model(), [evaluation(recorded, recorded.force)])


def test_warm_oil_is_named_over_several_recordings():
    """Each begins cold; at a steady mean power, heat and time cannot be told apart."""
    rides = [ride(seed) for seed in (1, 2)]
    dependence = dependences([errors(recorded, -0.6 * (1.0 - np.exp(-recorded.time_s / 100.0))) for recorded in rides])
    assert set(dependence[0].names) <= {"heat", "elapsed"}


def test_quantities_that_go_together_are_named_together():
    recorded = ride()
    recorded = replace(recorded, current=0.5 + 5.0 * recorded.position)
    (dependence,) = dependences([errors(recorded, groove(recorded) - groove(recorded).mean())])
    assert set(dependence.names) == {"position", "current"}
    assert "(these recordings do not tell which)" in describe(
        dependence, make_model(), [evaluation(recorded, recorded.force)]
    )


@pytest.mark.parametrize("pole", [0.0, 0.9, 0.998])
def test_noise_is_never_named(pole):
    for seed in range(4):
        recorded = ride(seed)
        assert dependences([evaluation(recorded, 200.0 * coloured(TICKS, pole, seed + 500))]) == []


def test_noise_that_grows_with_the_speed_a_gain_an_offset_and_a_small_error_are_not_named():
    recorded = ride()
    assert dependences([evaluation(recorded, 400.0 * np.abs(recorded.speed) * coloured(TICKS, 0.9, 5))]) == []
    assert dependences([errors(recorded, 0.3, 40.0)]) == []
    assert dependences([errors(recorded, 0.02 * groove(recorded))]) == []
    assert dependences([evaluation(recorded, np.zeros(TICKS))]) == []
    short = ride(ticks=1500)
    assert dependences([errors(short, groove(short))]) == []


def test_no_fit_comes_first_and_what_is_not_determined_last():
    recorded = ride()
    provenance = {"selection": {"undetermined": ["the lag is not determined: 5 ms assumed; record current steps"]}}
    model = make_model(provenance=provenance)
    own = replace(errors(recorded, 2.0 * (groove(recorded) - groove(recorded).mean())), role=IDENTIFICATION)
    lines = head_lines(model, [own])
    assert [line.split(" ")[:2] for line in lines] == [["The", "model"], ["The", "error"], ["The", "lag"]]
    assert lines[0] == f"The model does not fit its own data (J = {own.cost:.1f} %)."
    assert lines[2].endswith("record current steps.")
    noise = replace(evaluation(recorded, 300.0 * coloured(TICKS, 0.9, 3)), role=IDENTIFICATION)
    assert head_lines(make_model(), [noise])[0].endswith("no quantity explains it: check units, signs and delays.")
    assert head_lines(make_model(), [replace(noise, role="validation")]) == []
    assert head_lines(make_model(), [evaluation(recorded, np.full(TICKS, np.nan))]) == []
    assert head_lines(make_model(), [replace(own, run=replace(own.run, clamped=np.ones(TICKS, bool)))]) == []
