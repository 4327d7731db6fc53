import numpy as np
import pytest
from gap_traces import ar_noise, drive

from ces_gap.regions.axes import CURRENT, REVERSAL, SPEED, STROKE
from ces_gap.regions.locate import locate


def test_maps_show_where_the_gap_is_and_hide_fields_with_too_few_ticks():
    traces = [drive(1), drive(2)]
    fast = [(np.abs(t.inputs.speed) > 0.1) & (t.inputs.position > 0.0) for t in traces]
    gap = [40.0 * f + ar_noise(len(f), 8.0, 0.6, np.random.default_rng(k)) for k, f in enumerate(fast)]
    maps = locate(traces, gap, 8.0).maps
    assert [m.axes for m in maps] == [(SPEED, STROKE), (SPEED, CURRENT), (SPEED, REVERSAL)]
    for m in maps:
        assert m.rms_N.shape == m.samples.shape == (len(m.edges[1]) - 1, len(m.edges[0]) - 1)
        assert m.samples.sum() == sum(t.usable.sum() for t in traces)
        assert np.array_equal(np.isnan(m.rms_N), m.samples < 25)
    speed, stroke = (np.convolve(e, (0.5, 0.5), mode="valid") for e in maps[0].edges)
    full = maps[0].samples > 100
    hot = full & (stroke[:, None] > 0.004) & (np.abs(speed) > 0.13)
    assert maps[0].rms_N[hot] == pytest.approx(40.0, rel=0.1)
    assert np.median(maps[0].rms_N[full & (stroke[:, None] < 0.0)]) < 6.0


def test_a_constant_current_is_one_row():
    trace = drive(3, seconds=6.0, current="constant")
    assert len(locate([trace], [np.ones(len(trace))], 0.1).maps[1].rms_N) == 1
