"""The verdict in one sentence: the cause and its share."""

from __future__ import annotations

from dataclasses import replace

import pytest
from diagnoses import named

from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.verdict_sentence import format_verdict

FOUND = named()


def format_text(**changed: object) -> str:
    return format_verdict(replace(FOUND, **changed))  # type: ignore[arg-type]


@pytest.mark.parametrize("verdict", [NAMED, AMBIGUOUS, UNKNOWN, NO_GAP])
def test_the_verdict_is_one_sentence(verdict: str) -> None:
    text = format_text(verdict=verdict, indistinguishable=(("friction", "valve_lag"),) if verdict == AMBIGUOUS else ())
    assert text.endswith(".") and text.count(". ") == 0 and "\n" not in text
    assert "_" not in text and "None of" not in text.replace("None of the known effects", "")


def test_a_named_cause_comes_with_its_share_of_the_gap() -> None:
    assert "friction" in format_text() and "40 N" in format_text()


def test_several_causes_are_all_named() -> None:
    both = replace(FOUND.composition, effects=("friction", "position_delay"))
    assert "friction and position delay" in format_text(composition=both)


def test_indistinguishable_effects_are_named() -> None:
    text = format_text(
        verdict=AMBIGUOUS, indistinguishable=(("inertia", "gas_spring"), ("friction", "current_hysteresis"))
    )
    assert "between friction and current hysteresis" in text and "inertia" not in text


def test_other_possible_causes_are_named() -> None:
    first, second, *others = FOUND.causes
    causes = (first, replace(second, probability=0.3), *others)
    text = format_text(verdict=AMBIGUOUS, indistinguishable=(), causes=causes)
    assert "do not rule out valve lag;" in text and "with friction" in text


def test_an_unknown_cause_comes_with_the_closest_effect() -> None:
    assert "closest" in format_text(verdict=UNKNOWN) and "friction" in format_text(verdict=UNKNOWN)
    nothing = replace(FOUND.composition, effects=())
    assert "closest" not in format_text(verdict=UNKNOWN, composition=nothing)


def no_gap(rms_N: float, corrected_N: float) -> str:
    found: Diagnosis = replace(FOUND, verdict=NO_GAP, gap=replace(FOUND.gap, rms_N=rms_N, corrected_N=corrected_N))
    return format_verdict(found)


def test_without_a_gap_the_baseline_error_is_named() -> None:
    assert "baseline error" in no_gap(60.0, 3.0) and "60 N" in no_gap(60.0, 3.0)
    assert "baseline error" not in no_gap(3.0, 3.0) and "No gap" in no_gap(3.0, 3.0)
