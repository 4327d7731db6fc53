import numpy as np
import pytest
from residual_series import coloured, evaluation, series

from ces_identify.validation.residuals import error_cells, error_regions


def test_cells_add_up_to_the_whole_and_to_the_cost():
    ones = [series(6_000, seed) for seed in (1, 2)]
    both = [evaluation(one, 20.0 * coloured(6_000, 0.5, 3)) for one in ones]
    cells = error_cells(both)
    assert sum(c.energy for c in cells) == pytest.approx(1.0)
    assert sum(c.ticks for c in cells) == pytest.approx(1.0)
    assert [c.energy for c in cells] == sorted((c.energy for c in cells), reverse=True)
    alone = error_cells(both[:1])
    assert np.sqrt(sum(c.cost**2 for c in alone)) == pytest.approx(both[0].cost)


def test_the_worst_cell_is_where_the_error_was_put():
    one = series(20_000)
    bad = (one.speed > 0.15) & (one.speed < 0.3) & (one.current > 0.6)
    worst = error_cells([evaluation(one, 5.0 * coloured(20_000, 0.0, 3) + 200.0 * bad)])[0]
    low, _, high, _, current, _, top, _ = worst.region.replace(",", "").split()
    assert float(low) < 0.25 and float(high) > 0.15
    assert float(top) > 0.6 and float(current) > 0.4
    assert worst.energy > 3.0 * worst.ticks


def test_a_constant_current_leaves_speed_alone():
    one = series(current=np.full(10_000, 0.4))
    cells = error_cells([evaluation(one, coloured(10_000, 0.0, 3))])
    assert not any("A" in c.region for c in cells)
    assert len(cells) <= 6


def test_regions_of_each_axis_are_the_whole():
    e = evaluation(series(), 20.0 * coloured(10_000, 0.5, 3))
    regions = error_regions([e])
    for axis in ("direction", "zero crossing", "stroke"):
        parts = [r for r in regions if r.axis == axis]
        assert sum(r.energy for r in parts) == pytest.approx(1.0)
        assert sum(r.ticks for r in parts) == pytest.approx(1.0)
        assert np.sqrt(sum(r.cost**2 for r in parts)) == pytest.approx(e.cost)


def test_error_at_the_rebound_end_is_told_there():
    one = series()
    low = one.position < one.position.min() + 0.05 * np.ptp(one.position)
    end = next(r for r in error_regions([evaluation(one, 100.0 * low)]) if r.region == "rebound end")
    assert end.energy == pytest.approx(1.0)
    assert end.ticks < 0.1


def test_a_diverged_run_counts_as_far_as_it_went():
    error = np.where(np.arange(10_000) < 4_000, 10.0, np.nan)
    cells = error_cells([evaluation(series(), error)])
    assert sum(c.ticks for c in cells) == pytest.approx(1.0)
    assert all(c.rms_N == pytest.approx(10.0) for c in cells)
    assert error_cells([evaluation(series(), np.full(10_000, np.nan))]) == []
