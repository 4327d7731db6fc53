"""Planted networks and neuro-fuzzy models are found again, and nothing held out is seen."""

import signal
import threading
from dataclasses import replace

import numpy as np
import pytest
from planted import FUZZY, NETWORK, RATE_HZ, planted, with_values

from ces_identify.identification import identify
from ces_identify.limits import StabilityLimits
from ces_identify.numerics.search import NO_MORE_GAIN, TIME_IS_UP, Limits, SearchResult
from ces_identify.structures.fuzzy import FuzzyShape
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.lagged import NO_STEP
from ces_identify.structures.network import NetworkShape
from ces_identify.training import Lags
from ces_identify.validation.evaluate import VALIDATION

pytestmark = pytest.mark.slow
LAGS = Lags((1,), (0.0, 1 / RATE_HZ), (3 / RATE_HZ,))
KINDS = {"network": (NETWORK, NetworkShape(3, LAGS, 1e-8)), "fuzzy": (FUZZY, FuzzyShape(2, 1, 3 / RATE_HZ, LAGS, 1e-8))}
NOISE_N = 4.0


def options(**changes):
    fields = {"limits": Limits(time=30.0, starts=1, threads=1), "rate": RATE_HZ}
    return IdentifyOptions(**{"split": 1.0, **fields, **changes})


def identify_kind(kind, split=1.0, training=None, listener=lambda result: None, **changes):
    model, shape = KINDS[kind]
    recordings = training or [planted(model, 1), planted(model, 2)]
    fresh = planted(model, 3, name="fresh")
    return identify(recordings, [fresh], options(split=split, **changes), listener, shape)


@pytest.fixture(scope="module", params=list(KINDS))
def result(request):
    return request.param, identify_kind(request.param)


def test_cost_on_a_fresh_recording_is_the_noise_floor_and_the_band_holds_its_share(result) -> None:
    _, identified = result
    fresh = next(e for e in identified.evaluations if e.name == "fresh")
    assert fresh.role == VALIDATION
    assert fresh.rms_N == pytest.approx(NOISE_N, rel=0.1)
    assert 0.85 <= fresh.coverage <= 0.96  # planted noise; the band widens a little on other strokes


def test_the_model_is_certified_and_its_proof_stands(result):
    _, identified = result
    assert identified.model.certificate["gain"] < StabilityLimits.MAX_GAIN + 1e-9
    assert identified.model.is_stable()


@pytest.mark.parametrize("kind", list(KINDS))
def test_interruption_and_time_limit_keep_the_best_so_far(kind, monkeypatch):
    heard = []

    def listen(news):
        heard.extend([news] if isinstance(news, SearchResult) else [])

    quick = identify_kind(kind, limits=Limits(time=0.3, starts=1, threads=1), listener=listen)
    assert quick.search_results[0].ended in {TIME_IS_UP, NO_MORE_GAIN, NO_STEP}
    costs = [f.cost for f in heard]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == quick.search_results[0].cost

    def interrupt(*args, **kwargs):
        if threading.current_thread() is threading.main_thread() and len(heard) > 3:
            monkeypatch.undo()
            signal.raise_signal(signal.SIGINT)
        return set(), set(args[0])

    heard.clear()
    monkeypatch.setattr("ces_identify.numerics.search.wait", interrupt)
    broken_off = identify_kind(kind, limits=Limits(time=60.0, starts=1, threads=1), listener=listen)
    assert broken_off.search_results[0].ended == "interrupted"
    assert np.isfinite(broken_off.search_results[0].cost)


def test_without_a_certificate_none_is_written():
    loose = identify_kind("network", certificate=False, limits=Limits(time=10.0, starts=1, target=20.0))
    assert loose.model.certificate is None
    assert loose.search_results[0].ended == "target cost reached"


@pytest.mark.parametrize("kind", list(KINDS))
def test_a_preload_far_from_zero_is_no_obstacle(kind):
    recording = planted(KINDS[kind][0], 1)
    loaded = with_values(recording, force=recording.channel("force").values - 5000.0)
    identified = identify_kind(kind, 1.0, [loaded], limits=Limits(time=20.0, starts=1))
    assert identified.evaluations[0].rms_N < 2.0 * NOISE_N


def test_a_damper_slower_than_may_be_proved_is_met_as_nearly_as_may_be():
    slow = replace(NETWORK, body=replace(NETWORK.body, linear=(0.99, 0.05, 0.03, 0.0), constant=0.0, units=()))
    once = Limits(time=20.0, starts=1)
    identified = identify([planted(slow, 1)], [], options(limits=once), fitter=NetworkShape(2, LAGS, 1e-8))
    assert 0.95 < identified.model.certificate["gain"] < StabilityLimits.MAX_GAIN + 1e-9
    assert identified.evaluations[0].cost < 20.0
