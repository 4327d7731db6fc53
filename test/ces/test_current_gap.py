"""Currents far apart: what lies between them is not known, and every door says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ces
from ces_identify.polynomial.problem import find_current_gap

ROOT = Path(__file__).resolve().parents[2]
T = np.arange(0.0, 3.0, 0.002)
X = 0.02 * np.sin(2 * np.pi * 2.0 * T)
STAMPS_NS = np.round(1e9 * T).astype(int).tolist()


@pytest.mark.parametrize(
    ("currents", "gap"),
    [
        ([0.0, 1.0], (0.1, 0.9)),
        ([0.0, 0.25, 1.0], (0.35, 0.9)),
        ([0.0, 0.5, 1.0], None),
        ([0.0, 0.25, 0.75, 1.0], None),
        ([0.5, 0.52], None),  # the noise of one current
    ],
)
def test_a_wide_gap_between_recorded_currents_is_not_known(currents, gap):
    ticks = np.repeat(currents, 5000) + 0.002 * np.sin(np.arange(5000 * len(currents)))
    found = find_current_gap(np.append(ticks, np.linspace(0.0, 1.0, 50)) if gap else ticks)  # some on the way
    assert found == (gap and pytest.approx(gap, abs=0.01))


def test_currents_in_the_gap_are_warned_of_wherever_the_model_runs(tmp_path):
    pytest.importorskip("pandas")
    model = ces.Model.load(ROOT / "config/models/sample.json")
    holed = replace(model, envelope=replace(model.envelope, current_gap_A=(0.35, 0.65)))
    holed.save(tmp_path / "model.json")
    holed = ces.Model.load(tmp_path / "model.json")
    assert "A without 0.35 to 0.65" in repr(holed)
    with pytest.warns(UserWarning, match="100.0 % of the time: current 0.5.*without 0.35 to 0.65"):
        ces.simulate(holed, T, X, 0.5)
    with pytest.warns(UserWarning, match="currents 0.5 A: No current between 0.35 and 0.65 A was recorded"):
        holed.force_speed(0.5, 0.1)
    assert not [i for i in holed.force_speed(speeds=0.1).columns if 0.35 < i < 0.65]
    driven = {"time_s": T, "position_m": X, "current_A": 0.3, "force_N": 3000.0 * np.gradient(X, T)}
    page = holed.report(tmp_path / "page.html", driven).read_text(encoding="utf-8")
    assert "Currents between 0.35 and 0.65 A: none was recorded" in page


@pytest.mark.parametrize(("current_A", "is_outside"), [(0.34, False), (0.5, True), (0.66, False)])
def test_the_estimator_counts_a_current_in_the_gap_as_outside_and_keeps_its_force(current_A, is_outside):
    model = ces.Model.load(ROOT / "config/models/sample.json")
    holed = replace(model, envelope=replace(model.envelope, current_gap_A=(0.35, 0.65)))
    plain, estimator = ces.Estimator(model), ces.Estimator(holed)
    forces = [(plain.step(n, x, current_A), estimator.step(n, x, current_A)) for n, x in zip(STAMPS_NS, X, strict=True)]
    assert estimator.clamped == is_outside
    assert forces[-1][0] == forces[-1][1] is not None
    assert estimator.half_width() == (None if is_outside else plain.half_width()) and plain.half_width() > 0.0


def test_the_gap_has_no_band_whose_coverage_could_be_claimed():
    model = ces.Model.load(ROOT / "config/models/sample.json")
    holed = replace(model, envelope=replace(model.envelope, current_gap_A=(0.35, 0.65)))
    driven = {
        "time_s": T,
        "position_m": X,
        "current_A": np.where(T < 1.5, 0.3, 0.5),
        "force_N": 3000.0 * np.gradient(X, T),
    }
    with pytest.warns(UserWarning, match="without 0.35 to 0.65"):
        (plain,), (evaluation,) = model.validate(driven), holed.validate(driven)
    in_gap = evaluation.series.current == 0.5
    np.testing.assert_array_equal(evaluation.half_width, np.where(in_gap, np.nan, plain.half_width))
    scored = evaluation.series.scored
    inside = np.abs(evaluation.error) <= plain.half_width[scored]
    assert evaluation.coverage == np.mean(inside[~in_gap[scored]])
    with pytest.warns(UserWarning, match="100.0 % of the time"):
        assert holed.validate(driven | {"current_A": 0.5})[0].coverage is None
