"""The mean of models: its force, its file both ways, and its proof from those of its members."""

import json
from dataclasses import replace

import pytest
from damper_models import damper_with_past
from mixture_models import mixture_model

from ces_observer.errors import ModelError
from ces_observer.model import parse_model
from ces_observer.structures.mixture import Mixture


def test_the_force_is_the_mean_of_the_members_forces_each_held_in_its_own_range() -> None:
    model = mixture_model()
    runs = [one.body.make_predictor(one.within(model.operating_range)) for one in model.body.members]
    whole, held = model.make_predictor(), set()
    for k in range(200):
        inputs = 0.001 * (k % 15), 0.02 * (k % 60) - 0.6, 0.5
        mean = sum(one.weight * run.tick(*inputs) for one, run in zip(model.body.members, runs, strict=True))
        assert whole.tick(*inputs) == min(max(mean, -1200.0), 1500.0)
        assert (whole.held, whole.clamped) == (not -1200.0 <= mean <= 1500.0, False)
        held.add((whole.held, runs[0].held))
    assert len(held) > 1
    whole.tick(0.0, 1.5, 0.5)
    assert whole.clamped


def test_it_goes_through_a_file() -> None:
    model = mixture_model()
    certified = replace(model, certificate=model.certify().to_mapping())
    assert parse_model(certified.to_json(), "m.json").body == model.body
    assert "convex combination" in certified.certificate["claim"]
    assert model.size.startswith("mean of 3 models: 0.30 polynomial (3 terms), 0.45 recurrent (")
    assert "(polynomial, recurrent); used as they are up to 2 times" in model.body.outside


def member(**changes):
    return lambda raw: raw["mixture"]["members"][0].update(changes)


SPOILT = {
    "members[0]: weight is 0; expected a number from 1e-06": member(weight=0),
    "mixture: the weights of the members sum to 1.1; expected 1": member(weight=0.4),
    "members[0]: structure is 'mixture'; expected one of polynomial_narx": member(structure="mixture"),
    "members[0]: unknown key 'terms'; expected one of weight, structure, network": member(structure="sigmoid_narx"),
    "members[0]: force_envelope_N is [1, 0]": member(force_envelope_N=[1, 0]),
    "members is [{": lambda raw: raw["mixture"].update(members=raw["mixture"]["members"][:1]),
    "unknown key 'certificate'": member(certificate=None),
}


@pytest.mark.parametrize("message", SPOILT)
def test_a_spoilt_file_is_refused(message) -> None:
    raw = json.loads(mixture_model().to_json())
    SPOILT[message](raw)
    with pytest.raises(ModelError) as refused:
        parse_model(json.dumps(raw), "m.json")
    assert message in str(refused.value)


def test_it_is_proved_if_all_its_members_are() -> None:
    model = mixture_model()
    proof = model.certify()
    assert proof.holds and model.is_stable()
    bounds = [one.weight * one.body.certify(one.within(model.operating_range)).force_N for one in model.body.members]
    assert proof.force_N == pytest.approx(sum(bounds), rel=1e-12) and proof.force_N >= sum(bounds)
    first, *others = model.body.members
    unstable = replace(first, body=damper_with_past(1.01).body)
    model = replace(model, body=Mixture((*others, unstable)))
    assert not model.certify().holds and not model.is_stable()
    assert model.certify().doubt.startswith("polynomial: the gains of the past forces may sum to 1.01")
