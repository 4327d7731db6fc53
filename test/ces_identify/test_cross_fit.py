"""Every part of the data is held out once, from a model that has not seen it and is worse there."""

import numpy as np
import pytest
from rig_rides import rig_ride

from ces_identify.identification import cross_fit
from ces_identify.numerics.search import Limits
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures import KITS
from ces_identify.structures.auto import default_sizes
from ces_identify.structures.kit import IdentifyOptions

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
