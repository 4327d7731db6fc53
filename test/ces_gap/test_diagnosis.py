"""A diagnosis in one sentence: the cause and its share."""

from __future__ import annotations

from dataclasses import replace

import pytest
from diagnoses import named

from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis, format_verdict
from ces_gap.effects.effect import Composition, Setting
from ces_gap.effects.simulation_errors import SpeedCurve
from ces_gap.inference.judgement import (
    ALTERNATIVES,
    LEAVES_MORE,
    NOT_CONFIRMED,
    REMAINS,
    SIMULATION_ERROR,
    UNCERTAIN,
    UNDETERMINED,
)


def format_text(**changed: object) -> str:
    return format_verdict(replace(named(), **{"correction": object(), **changed}))  # type: ignore[arg-type]


@pytest.mark.parametrize("verdict", [NAMED, AMBIGUOUS, UNKNOWN, NO_GAP])
def test_the_verdict_is_one_sentence(verdict: str) -> None:
    reason = "noise" if verdict == NO_GAP else ""
    text = format_text(
        verdict=verdict,
        no_gap_reason=reason,
        indistinguishable=(("friction", "valve_lag"),) if verdict == AMBIGUOUS else (),
        doubt=ALTERNATIVES if verdict == AMBIGUOUS else "",
        alternatives=("valve_lag",) if verdict == AMBIGUOUS else (),
    )
    assert text.endswith(".") and text.count(". ") == 0 and "\n" not in text
    assert "_" not in text and "None of" not in text.replace("None of the known effects", "")


def test_a_named_cause_comes_with_its_share_of_the_gap() -> None:
    assert "the simulation's own error shrinks from 36.1 N to 4.5 N" in format_text()


def test_a_cause_that_a_recalibration_would_explain_too_is_named_with_that_remark() -> None:
    assert "a recalibration of the simulation would explain it, too." in format_text(not_separable=("friction",))
    assert "recalibration" not in format_text(not_separable=("leakage",))


def test_several_causes_are_all_named() -> None:
    both = replace(named().composition, effects=("friction", "position_delay"))
    assert "friction and position delay" in format_text(composition=both)


def test_indistinguishable_effects_are_named() -> None:
    text = format_text(
        verdict=AMBIGUOUS,
        doubt=ALTERNATIVES,
        alternatives=("current_hysteresis",),
        indistinguishable=(("inertia", "gas_spring"), ("friction", "current_hysteresis", "backlash")),
    )
    assert "between friction and current hysteresis;" in text and "inertia" not in text


def test_other_possible_causes_are_named() -> None:
    text = format_text(verdict=AMBIGUOUS, doubt=ALTERNATIVES, alternatives=("valve_lag",))
    assert "do not rule out valve lag;" in text and "with friction" in text


def test_the_closest_effect_is_the_one_that_leaves_least() -> None:
    first, second, *others = named().causes
    less = replace(second, gap_after_N=0.5 * named().composition.gap_after_N)
    text = format_text(verdict=UNKNOWN, causes=(first, less, *others))
    assert f"closest, {second.effects[0].replace('_', ' ')}, leaves {less.gap_after_N:.3g} N" in text


def test_an_unknown_cause_comes_with_the_closest_effect() -> None:
    assert "closest" in format_text(verdict=UNKNOWN) and "friction" in format_text(verdict=UNKNOWN)
    nothing = replace(named().composition, effects=(), gap_after_N=36.1)
    assert "closest, friction" in format_text(verdict=UNKNOWN, composition=nothing)
    assert "closest" not in format_text(verdict=UNKNOWN, composition=nothing, causes=())
    assert "a learner without physics 4 N" in format_text(verdict=UNKNOWN)
    unlimited = replace(named().gap, noise_known=False, noise_source="high frequencies, not limited by any source")
    assert "noise not known: high frequencies" in format_text(verdict=UNKNOWN, gap=unlimited)


@pytest.mark.parametrize(
    ("doubt", "text"),
    [
        (SIMULATION_ERROR, "Friction may be an error of the simulation itself; with friction, the gap beyond"),
        (UNDETERMINED, "The interval of an effect's size includes no effect"),
        (NOT_CONFIRMED, "The held-out recordings do not confirm"),
        (LEAVES_MORE, "leaves more of the gap's energy than it closes"),
        (
            REMAINS,
            "Something else remains beside friction, as a learner without physics leaves 4 N; with friction, the",
        ),
        (UNCERTAIN, "not certain enough to be named"),
    ],
)
def test_an_ambiguous_verdict_says_what_speaks_against_the_cause(doubt: str, text: str) -> None:
    assert text in format_text(verdict=AMBIGUOUS, doubt=doubt)
    withdrawn = replace(named().composition, effects=())
    assert "; what was fitted enlarges" in format_text(verdict=AMBIGUOUS, doubt=doubt, composition=withdrawn)


def no_gap(reason: str, rms_N: float, corrected_N: float) -> str:
    gap = replace(named().gap, rms_N=rms_N, corrected_N=corrected_N)
    found: Diagnosis = replace(named(), verdict=NO_GAP, no_gap_reason=reason, visible_from_N=57.0, gap=gap, timed_N=2.5)
    return format_verdict(found)


def test_no_gap_comes_with_what_it_lies_within() -> None:
    assert "within the measurement noise of 8.0 N" in no_gap("noise", 3.0, 3.0)
    assert "above the tolerance of 5.0 N: 3.0 N" in no_gap("tolerance", 3.0, 3.0)
    assert "timing" in no_gap("timing", 9.0, 9.0) and "2.5 of 9.0 N RMS remain" in no_gap("timing", 9.0, 9.0)


def test_behind_a_poor_simulation_the_smallest_visible_effect_is_stated() -> None:
    text = no_gap("baseline_error", 60.0, 3.0)
    assert "all but 3 N of the 60 N" in text and "below about 57 N RMS cannot be seen" in text


def test_a_model_that_knows_its_own_error_states_its_range_over_the_recordings() -> None:
    series = named().held_out[0]
    ranged = tuple(replace(series, trace=replace(series.trace, own_error_N=error_N)) for error_N in (45.0, 20.0))
    found = replace(named(), verdict=NO_GAP, no_gap_reason="baseline_error", held_out=ranged)
    assert "within the model's own error of 20 to 45 N" in format_verdict(replace(found, visible_from_N=35.0))


def test_what_closes_most_comes_first() -> None:
    both = replace(named().composition, effects=("valve_lag", "friction"))
    assert "friction and valve lag" in format_text(composition=both)


def test_a_calibration_comes_with_the_size_of_its_map() -> None:
    curve = Composition((Setting(SpeedCurve(), (10.0, 0.0, 0.0, 0.0, 20.0)),))
    text = format_text(composition=replace(named().composition, effects=("calibration",), composition=curve))
    assert "force map is off, most at" in text and "(+30 N)" in text and "m/s" in text and "recalibrated" in text
