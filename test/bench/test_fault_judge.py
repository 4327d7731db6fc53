"""The judge of bench/reliability finds what is wrong with an observer: each test breaks one rule of a sound episode."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from bench.reliability.judge import (
    BOUNDED,
    NONE,
    TRUE,
    EpisodeLimits,
    Fault,
    FaultEpisode,
    evaluate_episode,
    find_evidence,
)

MS = 1_000_000
BEGAN, GOOD, END = 1000, 1500, 3000  # [ms]
LATENCY_NS = MS // 2
SILENT = Fault("no samples", ("no position samples",), NONE, "silence", restarts=True)
RULES = EpisodeLimits((-100.0, 100.0), lambda stamp_ns: 50.0, 80.0, warm_up_s=0.1, max_age_s=0.5)


def ms(times):
    return [time * MS for time in times]


def heard(stamps, forces=None, late_ns=LATENCY_NS):
    stamps = ms(stamps)
    forces = forces or [50.0] * len(stamps)
    return SimpleNamespace(at=[s + late_ns for s in stamps], stamps=stamps, forces=forces, others=[0.0] * len(stamps))


def status(at, message="estimating", **values):
    return SimpleNamespace(at=at * MS, message=message, values=values)


def episode(fault=SILENT):
    return FaultEpisode(fault, BEGAN * MS, GOOD * MS, BEGAN * MS, (GOOD - 1) * MS, GOOD * MS)


STATUSES = [status(900), status(1200, "withholding: no position samples arrive")]
SOUND = [*range(BEGAN), *range(GOOD + 110, END)]


def wrong(stamps=SOUND, diagnoses=STATUSES, fault=SILENT, **others):
    return evaluate_episode(episode(fault), heard(stamps, **others), diagnoses, RULES).wrong


def test_a_sound_episode_passes():
    outcome = evaluate_episode(episode(), heard(SOUND), STATUSES, RULES)
    assert outcome.wrong == ()
    assert outcome.reason == "no position samples"
    assert outcome.recovery_s == pytest.approx(0.1105)
    assert (outcome.worst_force_N, outcome.worst_error_N) == (50.0, 0.0)


def test_estimates_of_unusable_samples_are_found():
    assert wrong([*SOUND[:BEGAN], 1200, *SOUND[BEGAN:]]) == ("1 estimates of unusable samples",)


def test_estimates_while_a_current_is_held_are_allowed():
    assert wrong([*SOUND[:BEGAN], 1200, *SOUND[BEGAN:]], fault=replace(SILENT, holds_s=0.25)) == ()


def test_a_late_recovery_is_found():
    assert wrong([*range(BEGAN), *range(GOOD + 400, END)]) == ("recovery took 0.40 s, allowed are 0.3",)


def test_no_recovery_is_found():
    assert wrong(list(range(BEGAN))) == ("no recovery",)


def test_silent_diagnostics_are_found():
    assert wrong(diagnoses=STATUSES[:1]) == ("is not in the diagnostics",)


def test_unexpected_errors_in_the_diagnostics_are_found():
    assert wrong(diagnoses=[*STATUSES, status(1300, "estimating; 1 unexpected errors")]) == (
        "estimating; 1 unexpected errors",
    )


@pytest.mark.parametrize("force", [101.0, float("inf"), float("nan")])
def test_forces_outside_the_envelope_are_found(force):
    forces = [50.0] * len(SOUND)
    forces[1050] = force
    assert "1 estimates not finite or outside the envelope" in wrong(forces=forces)


def test_a_wrong_force_after_recovery_is_found():
    forces = [50.0] * (len(SOUND) - 1) + [60.0]
    assert wrong(forces=forces) == ("force off by 10 N",)


def test_old_estimates_are_found():
    assert any("older than max_age_s" in one for one in wrong(late_ns=560 * MS))


def test_a_pause_is_found_where_estimates_have_to_go_on():
    fault = replace(SILENT, output=TRUE)
    assert "no estimate for 0.50 s" in wrong(fault=fault)
    assert wrong(list(range(END)), fault=fault) == ()


def test_bounded_output_need_not_be_true_during_the_fault():
    forces = [50.0] * BEGAN + [99.0] * (GOOD - BEGAN) + [50.0] * (END - GOOD)
    assert wrong(list(range(END)), forces=forces, fault=replace(SILENT, output=BOUNDED)) == ()
    assert wrong(list(range(END)), forces=forces, fault=replace(SILENT, output=TRUE)) == ("force off by 49 N",)


COUNT = Fault("lost", ("dropped",), TRUE, "dropouts")


@pytest.mark.parametrize(
    ("before", "after", "found"),
    [
        ({"position: dropped": "3"}, {"position: dropped": "4"}, "dropped"),
        ({"position: dropped": "3"}, {"position: dropped": "3"}, ""),
        ({}, {"position: dropped": "0"}, ""),
        ({"state": "none"}, {"state": "dropped it"}, "dropped"),
        ({"state": "dropped it"}, {"state": "dropped it"}, ""),
    ],
)
def test_evidence_is_a_count_that_rises_or_a_text_that_changes(before, after, found):
    assert find_evidence(COUNT, [status(900, **before), status(1100, **after)], BEGAN * MS, END * MS) == found


def test_evidence_may_be_a_value_that_doubles():
    flood = Fault("flood", (), BOUNDED, "flood", doubles="rate")
    assert not find_evidence(flood, [status(900, rate="1000"), status(1100, rate="1900")], BEGAN * MS, END * MS)
    assert find_evidence(flood, [status(900, rate="1000"), status(1100, rate="2100")], BEGAN * MS, END * MS) == "rate"


def test_diagnoses_after_the_time_allowed_are_no_evidence():
    assert not find_evidence(SILENT, [status(900), status(3100, "no position samples")], BEGAN * MS, END * MS)
