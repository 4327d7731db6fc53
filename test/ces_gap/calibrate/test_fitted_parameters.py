"""Parameters of users' own simulators, fitted: true values inside the intervals, and what cannot be known is said."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hydraulic_models import hydraulic_model, make_hydraulic
from physical_examples import make_valve

from bench.gaps.users_dampers import SIMULATORS, bouc_wen, filter_speed, knee, record
from ces_data.arrays import F
from ces_data.reading import as_recordings
from ces_gap.calibrate.calibration import calibrate, free_parameters
from ces_gap.errors import GapError
from ces_gap.report.calibration import calibration_content, describe
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, RecordedSimulation

DATA = Path(os.environ.get("CES_DATA", Path(__file__).parents[4] / "shared" / "data"))


def simulation(kind: str) -> FunctionSimulation:
    return FunctionSimulation(kind, SIMULATORS[kind])


def test_two_parameters_are_found_with_intervals_that_hold_them_and_the_gap_closes() -> None:
    true = {"knee_m_s": 0.104, "gas_N_m": 2990.0}
    result = calibrate(simulation("knee"), "knee", [record("knee", true, seed) for seed in (1, 2)])
    changed = {p.name: p for p in result.parameters if p.matters}
    assert set(changed) == set(true)
    assert all(changed[n].ci95[0] < value < changed[n].ci95[1] for n, value in true.items())
    assert result.before_N > 15.0 and result.after_N < 1.5 and result.missing is None
    text = describe(result)
    assert re.match(r"knee_m_s is 0.10\d*, not 0.12 \(0.10\d* to 0.10\d*\) and gas_N_m ", text)
    assert "With both the gap shrinks from " in text
    beside = replace(
        result, parameters=tuple(replace(p, matters=p.name != "gas_N_m" and p.matters) for p in result.parameters)
    )
    assert "With it and the fitted gas_N_m the gap shrinks from " in describe(beside)


def test_what_moves_with_others_is_held_at_its_default_and_said() -> None:
    result = calibrate(simulation("bouc_wen"), "b", [record("bouc_wen", {"alpha_N_m": 55000.0}, s) for s in (1, 2)])
    gamma = next(p for p in result.parameters if p.name == "gamma_1_m2")
    assert not gamma.determined and gamma.value == gamma.default
    assert "gamma_1_m2 cannot be determined: it moves with alpha_N_m and A; it is held at its default." in describe(
        result
    )
    content = calibration_content(result)["parameters"]
    assert content["gamma_1_m2"]["determined"] is False and content["alpha_N_m"]["matters"] is True


def test_an_effect_is_missing_beside_two_wrong_parameters() -> None:
    true = {"relief_N": 300.0, "stiffness_N_m": 3e5}
    recordings = [record("chamber", true, seed, mass_kg=2.0) for seed in (1, 2)]
    result = calibrate(simulation("chamber"), "c", recordings)
    assert {p.name for p in result.parameters if p.matters} == set(true)
    assert result.missing is not None and result.missing.setting.name == "inertia"
    assert result.missing.estimates[0].value == pytest.approx(2.0, rel=0.03)
    assert re.fullmatch(r"<inertia: mass_kg \S+; with it \S{1,7} N are left>", repr(result.missing))
    assert all(p.ci95[0] < true.get(p.name, p.default) < p.ci95[1] for p in result.parameters if p.name in true)
    assert re.search(r"Inertia of (1.99|2|2.01) kg is missing beside them: with it \S+ N are left", describe(result))


@pytest.mark.skipif(not DATA.is_dir(), reason=f"measured recordings are not in {DATA} (set CES_DATA)")
def test_values_that_are_worse_without_the_missing_effect_are_not_handed_back() -> None:
    """The simulation with the value beside friction left 567 N of 314 N, which were said to shrink."""

    def force(time_s: F, position_m: F, current_A: F, *, fmr_N: float = 900.0, c_N_s_m: float = 500.0) -> F:
        speed = np.gradient(position_m, time_s)
        return np.asarray((100.0 + fmr_N * current_A) * np.tanh(speed / 0.02) + c_N_s_m * speed)

    frame = pytest.importorskip("pandas").read_csv(DATA / "utfsm_mr" / "sine_10mm2Hz_0.75A.csv")
    frame.columns = ["Time [s]", "Position [mm]", "Current [A]", "Force [N]"]
    (recording,) = as_recordings(frame)
    result = calibrate(FunctionSimulation("m:f", force), "m:f", [recording.part(0.0, 5.0)], fit=["fmr_N"])
    assert result.missing is not None and result.missing.alone_N > result.before_N == result.after_N
    assert result.values == {"fmr_N": 900.0} and not result.parameters[0].determined
    same, defaults = result.simulation.force(recording), FunctionSimulation("m:f", force).force(recording)
    np.testing.assert_array_equal(same, defaults)
    text = f"gap of {result.before_N:.0f} N RMS; the fitted values alone leave {result.missing.alone_N:.0f} N, so the"
    assert text in describe(result) and "shrink" not in describe(result)
    content = calibration_content(result)
    assert content["parameters"]["fmr_N"]["value"] == 900.0
    assert content["missing"]["beside"]["fmr_N"]["value"] == result.missing.beside[0].value < 600.0
    assert "Value beside friction" in repr(result)


def test_only_the_named_parameters_are_fitted_and_the_end_of_a_range_is_no_end_of_an_interval() -> None:
    recordings = [record("knee", {"knee_m_s": 0.104}, seed, seconds=6.0) for seed in (1, 2)]
    result = calibrate(simulation("knee"), "knee", recordings, fit=["knee_m_s=0.11..0.2"])
    (knee,) = result.parameters
    assert knee.at_bound and not knee.determined and knee.value == pytest.approx(0.11, rel=0.01)
    frame = pytest.importorskip("pandas") and result.to_frame().set_index("parameter").loc["knee_m_s"]
    assert result.values == {"knee_m_s": knee.value} == {"knee_m_s": frame["value"]}
    assert frame["low"] == -np.inf and 0.11 < frame["high"] < 0.12 and frame["at_bound"] and not frame["determined"]
    assert calibration_content(result)["parameters"]["knee_m_s"]["determined"] is False
    assert re.search(r"at most 0.11\d +not determined, at the end of its range", repr(result))
    text = describe(replace(result, parameters=(replace(knee, matters=True),)))
    assert re.match(r"knee_m_s is at most 0.11\d, not 0.12. With it the gap ", text)
    assert "knee_m_s lies at the end of the range or far from the default" in text


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason=f"measured recordings are not in {DATA} (set CES_DATA)")
def test_what_measured_recordings_leave_open_within_its_range_keeps_its_default() -> None:
    """It was said to be determined from one end of its range to the other, and to lie at its bound."""

    def bingham(
        time_s: F, position_m: F, current_A: F, *, c0: float = 500.0, c1: float = 4000.0, k: float = 200.0
    ) -> F:
        speed = np.gradient(position_m, time_s)
        return np.asarray((c0 + c1 * current_A) * speed + k * np.tanh(speed / 0.01))

    names = *(f"sine_10mm2Hz_{current}A.csv" for current in ("0.25", "0.50", "0.75")), "sine_5mm4Hz_0.50A.csv"
    *real, held_out = as_recordings([DATA / "utfsm_mr" / name for name in names])
    result = calibrate(FunctionSimulation("bingham", bingham), "bingham", real, [held_out])
    c0, c1, k = result.parameters
    assert (c0.value, c0.ci95, c0.at_bound) == (c0.default, (-np.inf, np.inf), False) and c1.determined and k.determined
    assert "c0 cannot be determined: it moves with c1 and k; it is held at its default." in describe(result)


def test_a_hydraulic_model_is_calibrated_on_a_worn_damper(worn_recordings) -> None:  # type: ignore[no-untyped-def]
    model, recordings = worn_recordings
    result = calibrate(model, "model.json", recordings)
    assert {p.name for p in result.parameters if p.matters} == {"rebound_valve", "gas_rate"}
    fitted = {p.name: p for p in result.parameters}
    assert fitted["rebound_valve"].value == pytest.approx(0.88, rel=2e-3)
    assert fitted["gas_rate"].value == pytest.approx(1.3, rel=0.05) and not fitted["leak_m_s_rtN"].at_bound
    assert result.after_N < 0.1 * result.before_N and result.missing is None
    assert describe(result).startswith("rebound_valve is 0.88")


@pytest.fixture(scope="module")
def worn_recordings():  # type: ignore[no-untyped-def]
    """A hydraulic model, and two recordings of a damper whose rebound valve is softer and whose gas is stiffer."""
    model = ModelSimulation(hydraulic_model(make_hydraulic(make_valve())))
    worn = model.with_values({"rebound_valve": 0.88, "gas_rate": 1.3})
    bare = [record("knee", {}, seed, seconds=8.0) for seed in (1, 2)]
    return model, [with_force(r, worn) for r in bare]


def test_of_a_whole_number_each_value_is_tried() -> None:
    def staged(time_s: F, position_m: F, current_A: F, *, stages: int = 1, gain_N: float = 100.0) -> F:
        speed = filter_speed(time_s, position_m)
        return np.asarray(gain_N * np.tanh(speed / 0.1) ** (2 * stages - 1))

    whole = FunctionSimulation("staged", staged)
    recordings = [record("knee", {}, seed, seconds=6.0) for seed in (1, 2)]
    fake = [with_force(r, whole.with_values({"stages": 3.0, "gain_N": 130.0})) for r in recordings]
    result = calibrate(whole, "staged", fake, fit=["stages=1..4", "gain_N"])
    assert {p.name: round(p.value) for p in result.parameters} == {"stages": 3, "gain_N": 130}
    assert calibrate(whole, "staged", fake).notes[0] == (
        "stages is not fitted: it is a whole number (1); give stages=LOW..HIGH to try each, or write 1.0"
    )


def with_force(recording, simulation):  # type: ignore[no-untyped-def]
    """Return the recording with a simulation's force and noise."""
    from dataclasses import replace

    force = np.nan_to_num(simulation.force(recording)) + np.random.default_rng(1).normal(
        0.0, 3.0, len(recording.channel("position"))
    )
    channel = replace(recording.channel("force"), values=force)
    return replace(recording, channels={**recording.channels, "force": channel})


def test_a_function_with_a_state_is_refused() -> None:
    calls: list[int] = []

    def counting(time_s: F, position_m: F, current_A: F, *, seal_N: float = 25.0) -> F:
        calls.append(1)
        return knee(time_s, position_m, current_A, seal_N=seal_N + len(calls))

    with pytest.raises(GapError, match=r"f: two equal calls on knee_1 differ by .* N RMS, so it keeps a state"):
        calibrate(FunctionSimulation("f", counting), "f", [record("knee", {}, 1, seconds=6.0)])


def test_values_with_which_the_function_fails_are_left_out_of_the_fit() -> None:
    def picky(time_s: F, position_m: F, current_A: F, *, gas_N_m: float = 1500.0) -> F:
        if gas_N_m > 3100.0:
            raise ValueError("too stiff")
        return knee(time_s, position_m, current_A, gas_N_m=gas_N_m)

    recordings = [record("knee", {"gas_N_m": 3000.0}, seed, seconds=6.0) for seed in (1, 2)]
    (gas,) = calibrate(FunctionSimulation("f", picky), "f", recordings).parameters
    assert gas.value == pytest.approx(3000.0, rel=0.02)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["seal"], "fit='seal': f has no such parameter; it has c0_N_s_m, "),
        (["A=2..1"], "fit='A=2..1': expected NAME or NAME=LOW..HIGH"),
        (["A=2..3"], "fit='A=2..3': expected a range around its default of 1"),
        (["none"], "f: no parameter to fit: "),
    ],
)
def test_wrong_words_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(GapError, match=re.escape(message)):
        calibrate(FunctionSimulation("f", bouc_wen), "f", [], fit=words)


def test_a_default_of_zero_needs_a_range_and_predictions_have_no_parameters() -> None:
    def free(time_s: F, position_m: F, current_A: F, *, offset_N: float = 0.0) -> F:
        return np.full_like(position_m, offset_N)

    with pytest.raises(GapError, match=r"its default of 0 gives no range; give offset_N=LOW..HIGH"):
        calibrate(FunctionSimulation("f", free), "f", [])
    with pytest.raises(GapError, match="no parameter to fit"):
        calibrate(RecordedSimulation("/p"), "topic:/p", [])
    recordings = [
        with_force(record("knee", {}, 1, seconds=6.0), FunctionSimulation("f", free).with_values({"offset_N": -30.0}))
    ]
    (offset,) = calibrate(FunctionSimulation("f", free), "f", recordings, fit=["offset_N=-100..100"]).parameters
    assert offset.value == pytest.approx(-30.0, abs=0.5)


def test_a_diagnosis_does_not_fit_for_an_hour_unasked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ces_gap.limits.ParameterLimits.MAX_UNASKED_S", 0.0)
    recordings = [record("knee", {"knee_m_s": 0.2}, 1, seconds=6.0)]
    fixed = free_parameters(simulation("knee"), "knee", recordings, True, (), None)
    assert not fixed.competed and "the parameters keep their values" in fixed.notes[0]
    asked = free_parameters(simulation("knee"), "knee", recordings, True, (), None, ["knee_m_s"])
    assert [p.name for p in asked.freed] == ["knee_m_s"]


def test_a_diagnosis_keeps_calibrated_values_unless_they_are_named() -> None:
    """They were fitted again, within ten times what the calibration had found."""
    recordings = [record("knee", {"knee_m_s": 0.2}, 1, seconds=6.0)]
    calibrated = simulation("knee").with_values({"knee_m_s": 0.104})
    held = free_parameters(calibrated, "knee", recordings, True, (), None)
    assert held.simulation is calibrated and not held.competed and "the calibrated values are kept" in held.notes[0]
    asked = free_parameters(calibrated, "knee", recordings, True, (), None, ["knee_m_s"])
    assert [p.name for p in asked.freed] == ["knee_m_s"]
