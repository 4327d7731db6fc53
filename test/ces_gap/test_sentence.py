"""The verdict in one sentence: who, how much, and no more than that."""

from __future__ import annotations

from dataclasses import replace

import pytest
from diagnoses import named

from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.sentence import format_verdict

FOUND = named()


def told(**changed: object) -> str:
    return format_verdict(replace(FOUND, **changed))  # type: ignore[arg-type]


@pytest.mark.parametrize("verdict", [NAMED, AMBIGUOUS, UNKNOWN, NO_GAP])
def test_it_is_one_sentence_in_words(verdict: str) -> None:
    text = told(verdict=verdict, indistinguishable=(("friction", "valve_lag"),) if verdict == AMBIGUOUS else ())
    assert text.endswith(".") and text.count(". ") == 0 and "\n" not in text
    assert "_" not in text and "None of" not in text.replace("None of the known effects", "")


def test_a_named_cause_comes_with_what_it_explains() -> None:
    assert "friction" in told() and "40 N" in told()


def test_several_causes_are_all_named() -> None:
    both = replace(FOUND.composition, effects=("friction", "position_delay"))
    assert "friction and position delay" in told(composition=both)


def test_twins_are_named_as_twins() -> None:
    text = told(verdict=AMBIGUOUS, indistinguishable=(("inertia", "gas_spring"), ("friction", "current_hysteresis")))
    assert "between friction and current hysteresis" in text and "inertia" not in text


def test_a_cause_that_is_possible_beside_is_not_ruled_out() -> None:
    first, second, *others = FOUND.causes
    causes = (first, replace(second, probability=0.3), *others)
    text = told(verdict=AMBIGUOUS, indistinguishable=(), causes=causes)
    assert "do not rule out valve lag;" in text and "with friction" in text


def test_nothing_known_names_the_nearest_if_there_is_one() -> None:
    assert "closest" in told(verdict=UNKNOWN) and "friction" in told(verdict=UNKNOWN)
    nothing = replace(FOUND.composition, effects=())
    assert "closest" not in told(verdict=UNKNOWN, composition=nothing)


def no_gap(rms_N: float, corrected_N: float) -> str:
    found: Diagnosis = replace(FOUND, verdict=NO_GAP, gap=replace(FOUND.gap, rms_N=rms_N, corrected_N=corrected_N))
    return format_verdict(found)


def test_without_a_gap_the_simulations_own_error_is_told_if_there_is_one() -> None:
    assert "baseline error" in no_gap(60.0, 3.0) and "60 N" in no_gap(60.0, 3.0)
    assert "baseline error" not in no_gap(3.0, 3.0) and "No gap" in no_gap(3.0, 3.0)
