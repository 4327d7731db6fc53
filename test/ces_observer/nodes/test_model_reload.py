"""A model is proved in a process of its own, and its verdict comes back; a wrong one says why."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest
from damper_models import plain_damper

from ces_observer.control.model_inverse import ModelInverse
from ces_observer.model import Model
from ces_observer.nodes.model_check import INVERT, PROVE
from ces_observer.nodes.model_reload import ModelReload, Verdict
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Term

STARTING_S = 0.1  # more than forking takes, less than the child's start


def unstable() -> Model:
    model = plain_damper()
    past, *others = model.body.terms
    return replace(model, body=Polynomial((Term(1.01, past.factors), *others)))


def verdict_of(reload: ModelReload) -> Verdict:
    end = time.monotonic() + 30.0
    while (verdict := reload.poll()) is None:
        assert time.monotonic() < end
        time.sleep(0.01)
    return verdict


def test_a_stable_model_is_accepted_and_reported_once() -> None:
    reload, model = ModelReload(), plain_damper()
    began = time.monotonic()
    reload.start(model, "model.json", [PROVE])
    assert reload.poll() is None
    assert time.monotonic() - began < STARTING_S
    assert verdict_of(reload) == Verdict(model, "model.json", "")
    assert reload.poll() is None


def test_an_unstable_model_is_refused_with_the_reason() -> None:
    reload = ModelReload()
    reload.start(unstable(), "worn.json", [PROVE])
    assert verdict_of(reload).error.startswith("worn.json: it is not proved to be a contraction")


def test_without_a_check_it_is_accepted_at_once() -> None:
    reload = ModelReload()
    reload.start(unstable(), "worn.json", [])
    verdict = reload.poll()
    assert verdict is not None and not verdict.error


def test_the_inverse_survives_a_round_trip_as_text() -> None:
    reload, model = ModelReload(), plain_damper()
    reload.start(model, "model.json", [PROVE, INVERT])
    verdict = verdict_of(reload)
    assert verdict.error == ""
    assert ModelInverse.from_json(verdict.output) == ModelInverse.from_model(model)


def test_a_model_without_an_inverse_is_refused_with_the_reason() -> None:
    reload, model = ModelReload(), plain_damper()
    reload.start(replace(model, envelope=replace(model.envelope, speed_m_s=(0.0, 1.0))), "one_way.json", [INVERT])
    assert verdict_of(reload).error == "one_way.json: speeds from 0 to 1 m/s; a controller needs both directions"


def test_a_newer_model_takes_the_place_of_the_one_being_checked() -> None:
    reload = ModelReload()
    reload.start(unstable(), "old.json", [PROVE])
    reload.start(plain_damper(), "new.json", [PROVE])
    assert verdict_of(reload).source == "new.json"
    assert reload.poll() is None


def test_a_check_that_dies_is_no_acceptance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONHOME", "/nowhere")  # the child cannot even start
    reload = ModelReload()
    reload.start(plain_damper(), "model.json", [PROVE])
    assert "model.json: its check ended with status" in verdict_of(reload).error


def test_a_cancelled_check_leaves_no_verdict() -> None:
    reload = ModelReload()
    reload.start(plain_damper(), "model.json", [PROVE])
    reload.cancel()
    assert reload.poll() is None
