"""The comparison with other tools on recordings: blocks, columns, scaling, the choice of a setting, and the table."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "bench"))

import measurement
from identification_peers import PeerModel
from recorded_cases import (
    EVERY,
    PLAIN,
    PREPARED,
    RecordedCase,
    cut_blocks,
    fit_peer,
    make_case,
    mean_cost,
    three_channels,
)
from recorded_peers import FitJob, ToolOutcome, format_rows, merge, present_cases, wanted_tools

RATE, SECONDS = 500, 17.0


def recording(name="rough", seed=1):
    """A stroke of several sines; force linear in position, true speed and current."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(SECONDS * RATE)) / RATE
    omega, phase = 2.0 * np.pi * np.array([1.1, 2.3, 5.2]), rng.uniform(0.0, 6.0, 3)
    size = np.array([0.01, 0.004, 0.001])
    position = np.sin(np.outer(time, omega) + phase) @ size
    speed = np.cos(np.outer(time, omega) + phase) @ (size * omega)
    current = 0.5 + 0.2 * np.sin(2.0 * np.pi * 0.7 * time)
    force = 40.0 + 900.0 * speed + 2000.0 * position + 100.0 * current
    return three_channels(name, np.rint(1e9 * time).astype(np.int64), position, current, force)


@pytest.fixture(scope="module")
def case() -> RecordedCase:
    return make_case([recording()], "rough, rest")


def linear_peer(estimation, selection):
    """A tool as simple as can be: least squares on the columns, with a constant."""
    assert len(selection.force) < len(estimation.force)
    with_one = lambda inputs: np.column_stack([inputs, np.ones(len(inputs))])  # noqa: E731
    found = np.linalg.lstsq(with_one(estimation.inputs), estimation.force, rcond=None)[0]
    return PeerModel(lambda data: with_one(data.inputs) @ found, len(found))


def test_blocks_cover_the_training_data_once(case):
    blocks = cut_blocks(case.training)
    times = np.sort(np.concatenate([one.time_s for one in (*blocks.estimation, *blocks.selection)]))
    np.testing.assert_array_equal(times, case.training[0].time_s)
    (rest,) = case.tests["rough, rest"]
    assert case.training[0].time_s[-1] < rest.time_s[0]
    assert len(blocks.selection) == (len(blocks.estimation) + len(blocks.selection)) // EVERY


@pytest.mark.parametrize("feed", [PLAIN, PREPARED])
def test_a_peer_gets_scaled_columns_and_its_run_is_in_newtons(case, feed):
    fitted = fit_peer(linear_peer, feed, case, 1.0)
    assert fitted.parameters == len(feed.signals) + 1
    assert mean_cost(case.tests["rough, rest"], lambda one: one.force) == 0.0
    assert fitted.selection_cost < 3.0
    assert mean_cost(case.tests["rough, rest"], fitted.simulate) < 3.0  # what is left is the causal speed's error


def test_the_setting_is_chosen_on_selection_data_and_pays_for_all():
    better_test, chosen = ToolOutcome({"rig": 1.0}, 9.0, 10, 4.0), ToolOutcome({"rig": 2.0}, 8.0, 12, 3.0)
    setting, merged = merge({"a": better_test, "b": chosen, "c": replace(chosen, selection_cost=math.inf)})
    assert (setting, merged.costs, merged.cpu_s) == ("b", {"rig": 2.0}, 10.0)


def test_the_table_marks_the_best_and_leaves_out_what_failed():
    good = ToolOutcome({"rig, road": 3.456, "rig, sine": 2.0}, 3.0, 70, 12.4)
    loose = replace(good, costs={"rig, road": 5e4, "rig, sine": 1.25})
    outcomes = {
        FitJob("rig", "ours", ""): good,
        FitJob("rig", "fastcan", ""): loose,
        FitJob("rig", "broken", "x"): ToolOutcome({}, math.inf, 0, 0.0, "ValueError: no"),
    }
    assert format_rows(outcomes) == [
        ("tool", "rig, road", "rig, sine", "parameters", "CPU s"),
        ("ours", "**3.46**", "2.00", "70", "12"),
        ("fastcan", "diverges", "**1.25**", "70", "12"),
        ("broken", "-", "-", "", "0"),
    ]


def test_missing_data_and_tools_are_skipped_with_one_line_each(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("CES_DATA", str(tmp_path))
    assert present_cases(["rig", "dyke", "utfsm-sines"]) == ["rig"]
    assert capsys.readouterr().err.count("\n") == 2
    monkeypatch.setattr(measurement.importlib.metadata, "version", _missing)
    measurement.is_installed.cache_clear()
    assert wanted_tools(["fastcan", "GRU", "hydraulic"]).keys() == {"**hydraulic**"}
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(" is not installed: skipped")[0] for line in lines] == ["fastcan", "torch"]
    measurement.is_installed.cache_clear()


def _missing(name):
    raise measurement.importlib.metadata.PackageNotFoundError(name)
