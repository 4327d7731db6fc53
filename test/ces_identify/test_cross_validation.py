"""Every part of the data is held out once, from a model that has not seen it and is worse there."""

from dataclasses import replace

import numpy as np
import pytest
from planted import NETWORK, SAMPLING, planted
from rig_rides import rig_ride

from ces_identify.identification import IdentificationResult, cross_fit, cross_validate, split_folds
from ces_identify.numerics.search import Limits
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures import KITS
from ces_identify.structures.auto import default_sizes
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, evaluate


def recordings(count, seconds=6.0):
    return [planted(NETWORK, seed, seconds=seconds, name=f"r{seed}") for seed in range(count)]


def stand_in(calls):
    """An identifier that always finds the planted model, and remembers what it was given."""

    def identify(identification, held_out, options):
        calls.append(([r.name for r in identification], [r.name for r in held_out], options.split))
        evaluations = evaluate(NETWORK, [prepare(r, SAMPLING) for r in identification], IDENTIFICATION)
        evaluations += evaluate(NETWORK, [prepare(r, SAMPLING) for r in held_out], VALIDATION)
        return IdentificationResult(NETWORK, tuple(evaluations), ())

    return identify


def test_each_recording_is_held_out_once():
    calls = []
    result = cross_validate(recordings(5), 2, stand_in(calls), IdentifyOptions())
    assert calls == [(["r1", "r3"], ["r0", "r2", "r4"], 1.0), (["r0", "r2", "r4"], ["r1", "r3"], 1.0)]
    assert sorted(row.recording for row in result.rows) == [f"r{i}" for i in range(5)]
    assert [row.fold for row in result.rows] == [1, 1, 1, 2, 2]
    costs = [row.cost for row in result.rows]
    assert result.mean == pytest.approx(np.mean(costs))
    assert result.spread == pytest.approx(np.std(costs, ddof=1))
    assert all(row.interval.low < row.cost < row.interval.high for row in result.rows)
    calls.clear()
    cross_validate(recordings(3), 3, stand_in(calls), IdentifyOptions())
    assert [held for _, held, _ in calls] == [["r0"], ["r1"], ["r2"]]


def test_a_single_recording_is_cut_into_stretches_that_no_model_steps_across():
    one = recordings(1, 12.0)[0]
    folds = split_folds([one], 3)
    assert [len(f.identification) for f in folds] == [1, 2, 1]
    stamps = one.channel("position").stamps_ns
    for fold in folds:
        parts = [r.channel("position").stamps_ns for r in (*fold.identification, *fold.held_out)]
        np.testing.assert_array_equal(np.sort(np.concatenate(parts)), stamps)
    held = np.concatenate([f.held_out[0].channel("force").values for f in folds])
    np.testing.assert_array_equal(held, one.channel("force").values)
    assert [f.held_out[0].name for f in folds] == ["r0 0.0-4.0 s", "r0 4.0-8.0 s", "r0 8.0-12.0 s"]


def test_a_diverged_fold_is_no_number():
    calls = []
    inner = stand_in(calls)

    def identify(identification, held_out, options):
        result = inner(identification, held_out, options)
        return replace(result, evaluations=tuple(replace(e, cost=float("inf")) for e in result.evaluations))

    result = cross_validate(recordings(2), 2, identify, IdentifyOptions())
    assert result.mean == result.spread == float("inf")
    assert all(row.interval is None for row in result.rows)


LIMITS = Limits(threads=1, work=0.1)


def fitted(recordings):
    fitter = KITS["hydraulic"].fitter({**default_sizes(), "kind": "uniflow", "curves": "2"})
    return cross_fit(recordings, IdentifyOptions(limits=LIMITS, band=False), lambda result: None, fitter)


@pytest.mark.slow
def test_each_recording_is_left_out_of_one_model_that_is_worse_there():
    recordings = [rig_ride(1), rig_ride(2)]
    found = fitted(recordings)
    assert [(p.recording, p.start_s, p.stop_s) for p in found.parts] == [(0, -np.inf, np.inf), (1, -np.inf, np.inf)]
    for part in found.parts:
        series = prepare(recordings[part.recording], part.model.sampling)

        def rms(model, series=series):
            return float(np.std((simulate_series(model, series).force - series.force)[series.scored]))

        assert rms(found.result.model) < rms(part.model) < 2.0 * rms(found.result.model)


@pytest.mark.slow
def test_of_a_single_recording_stretches_are_left_out_that_cover_it_and_models_repeat() -> None:
    found, again = fitted([rig_ride(1)]), fitted([rig_ride(1)])
    parts = found.parts
    edges = [(p.start_s, p.stop_s) for p in parts]
    assert len(parts) == 3 and edges[0][0] == -np.inf and edges[-1][1] == np.inf
    assert [stop for _, stop in edges[:-1]] == pytest.approx([start for start, _ in edges[1:]])
    assert len({p.model.to_json() for p in parts}) == 3
    assert found.result.model.to_json() == again.result.model.to_json()
    assert [p.model.to_json() for p in parts] == [p.model.to_json() for p in again.parts]
