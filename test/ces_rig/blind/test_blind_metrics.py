"""A blind test: a balanced plan, known values of each statistic, and the criteria of a right answer."""

from dataclasses import replace
from math import inf, isnan

import numpy as np
import pytest

from ces_observer.errors import CesError
from ces_rig.blind.metrics import (
    METRICS,
    calibration_error,
    candidates,
    metric_table,
    quantile,
    rate,
    withheld_table,
)
from ces_rig.blind.scoring import CaseOutcome, Mode, closure, combine_modes

RIGHT = CaseOutcome(
    case="0001", kind="effect", truth=("friction",), gap_to_noise=3.0, baseline_ratio=0.0, excitation="rich", plant="a",
    verdict="named", ranked=("friction", "leakage", "inertia"), probability={"friction": 0.95, "none": 0.05},
    composition=("friction",), indistinguishable=(),
)  # fmt: skip
WRONG = replace(RIGHT, truth=("inertia",))
PAIR = replace(RIGHT, kind="pair", truth=("friction", "leakage"), composition=("leakage", "friction"))


def test_the_interval_of_a_rate_is_wilsons():
    assert rate([True] * 9 + [False]).interval == pytest.approx((0.5958, 0.9821), abs=1e-4)
    assert isnan(rate([]).value)


@pytest.mark.parametrize(("share", "count"), [(0.1, 30), (0.5, 11), (0.9, 4)])
def test_intervals_of_quantiles_hold_for_few_cases(share, count):
    rng = np.random.default_rng(count)
    true = -np.log(1.0 - share)
    intervals = [quantile(rng.exponential(size=count), share).interval for _ in range(300)]
    assert np.mean([low <= true <= high for low, high in intervals]) >= 0.94


def test_few_cases_leave_an_end_of_a_quantile_open():
    assert quantile([0.7, 0.8, 0.9, 0.95], 0.1).interval == (-inf, 0.9)


def test_calibration_error():
    p = np.array([0.9] * 10 + [0.25] * 4)[:, None]
    right = np.array([1.0] * 9 + [0.0] + [1.0, 0.0, 0.0, 0.0])[:, None]
    assert calibration_error(p, right).value == pytest.approx(0.0)
    assert calibration_error(p, np.zeros((14, 1))).value == pytest.approx(10.0 / 14.0)


@pytest.mark.parametrize("too_sure", [0.0, 0.2])
def test_intervals_of_the_calibration_error_hold(too_sure):
    """The calibration error of few cases is above zero even if the probabilities are right."""
    rng = np.random.default_rng(4)
    inside = []
    for _ in range(300):
        claimed = rng.uniform(0.7, 0.8, (69, 1))  # one bin: the hardest, for several bins add up their errors
        low, high = calibration_error(claimed, (rng.random((69, 1)) < claimed - too_sure).astype(float)).interval
        inside.append(low <= too_sure <= high)
    assert np.mean(inside) >= 0.92


def test_outcomes():
    assert RIGHT.is_in_top(1)
    assert not WRONG.is_in_top(1)
    assert WRONG.is_in_top(3)
    assert WRONG.is_named_wrongly() and not RIGHT.is_named_wrongly()
    assert replace(WRONG, indistinguishable=(frozenset({"friction", "inertia"}),)).is_first_by_class()
    assert not replace(WRONG, indistinguishable=(frozenset({"friction", "backlash"}),)).is_first_by_class()


def test_both_of_a_pair():
    assert PAIR.finds_exactly()
    assert not replace(PAIR, composition=("friction",)).finds_exactly()
    assert not replace(PAIR, composition=("friction", "leakage", "inertia")).finds_exactly()


def test_candidates_include_an_answer_without_a_probability():
    claimed, right = candidates([RIGHT, replace(RIGHT, kind="outside", truth=("hum",)), PAIR])
    assert claimed.shape == right.shape == (2, 3)  # friction, none, unknown
    assert right.sum(axis=1).tolist() == [1.0, 1.0]
    assert right[1].tolist() == [0.0, 0.0, 1.0]


def test_metrics_count_only_their_own_kinds_of_case():
    cases = [RIGHT, WRONG, PAIR, replace(RIGHT, kind="none", truth=(), verdict="ambiguous")]
    figures = {
        one.name: one.count(cases) for one in METRICS if one.name in ("first", "false alarms", "pairs (both found)")
    }
    assert {name: (f.value, f.count) for name, f in figures.items()} == {
        "first": (0.5, 2), "false alarms": (1.0, 1), "pairs (both found)": (1.0, 1)
    }  # fmt: skip
    assert "|effect: inertia|named 1|friction 1|" in withheld_table(cases).to_markdown()


def test_without_references_a_wrong_simulation_is_a_cause_of_its_own():
    alone = replace(RIGHT, kind="none", truth=(), baseline_ratio=1.0, mode=Mode("run", 0), ranked=("calibration",))
    right = [replace(alone, verdict="no_gap", composition=()), replace(alone, verdict="unknown", composition=())]
    right += [replace(alone, verdict="named", composition=("calibration",))]
    assert not any(case.is_false_alarm() for case in right)
    assert replace(alone, composition=("calibration", "friction")).is_false_alarm()
    assert all(replace(case, baseline_ratio=0.0).is_false_alarm() for case in right[1:])
    assert all(replace(case, mode=Mode("run", 2)).is_false_alarm() for case in right[1:])
    claimed, true = candidates([replace(alone, probability={"calibration": 0.6, "unknown": 0.3, "friction": 0.1})])
    assert float((claimed * true).sum()) == pytest.approx(0.9) and claimed.sum() == pytest.approx(1.0)


def test_calibration_beside_the_right_effect_is_not_wrong():
    both = replace(RIGHT, composition=("calibration", "friction"), baseline_ratio=1.0, mode=Mode("run", 0))
    assert both.finds_exactly() and not both.is_named_wrongly()
    assert replace(both, baseline_ratio=0.0).is_named_wrongly()
    assert replace(both, composition=("calibration",)).is_named_wrongly()
    assert replace(both, composition=("calibration", "friction", "inertia")).is_named_wrongly()
    assert not replace(both, composition=("inertia",), verdict="ambiguous").is_named_wrongly()


def test_a_target_is_met_or_not_only_if_the_whole_interval_says_so():
    model = replace(RIGHT, mode=Mode("identified", 2))
    table = metric_table("mode", {"run_2": [RIGHT] * 9 + [WRONG], "identified_2": [model]}).to_markdown()
    assert "90.0 % (59.6 % to 98.2 %; 10); ≥ 94.0 % undecided" in table
    assert "; 1); ≥ 80.0 % undecided" in table
    groups = {"run_2": [RIGHT] * 400, "identified_2": [replace(WRONG, mode=model.mode)] * 40}
    many = metric_table("mode", groups).to_markdown()
    assert "100.0 % (99.0 % to 100.0 %; 400); ≥ 94.0 % met" in many
    assert "0.0 % (0.0 % to 8.8 %; 40); ≥ 80.0 % **not met**" in many


def test_modes():
    assert [mode.name for mode in combine_modes(["run", "identified"], [0, 2])] == ["run_0", "run_2", "identified_2"]
    classes = {mode.name: mode.class_name for mode in combine_modes(["run", "predictions", "identified"], [0, 1])}
    assert classes == {
        "run_0": "no_references", "run_1": "references", "predictions_0": "predictions",
        "predictions_1": "predictions", "identified_1": "identified",
    }  # fmt: skip
    for simulation, references in (("identified", 0), ("walk", 1), ("run", 6)):
        with pytest.raises(CesError, match=r"expected|add references"):
            Mode(simulation, references)


def test_closure():
    rng = np.random.default_rng(2)
    force, effect, error = rng.normal(0.0, [[900.0], [24.0], [18.0]], (3, 20_000))
    truth = {"h1_force_N": force}
    replay = {"h1_simulated_N": force - effect - error, "h1_augmented_N": force - 0.5 * effect - 0.1 * error}
    got = closure(truth, replay, "h1")
    assert got["closure"] == pytest.approx(1.0 - np.hypot(12.0, 1.8) / 30.0, abs=0.01)
    assert closure(truth, {name: values[1:] for name, values in replay.items()}, "h1") == {}
    corrected = replay | {"h1_corrected_N": force - effect}  # references taught the error
    assert closure(truth, corrected, "h1")["closure"] == pytest.approx(1.0 - np.hypot(12.0, 1.8) / 24.0, abs=0.01)
