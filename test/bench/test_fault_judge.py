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


def forced(changes, count=None):
    """Forces of 50 N but for those of `changes` (index to value)."""
    return [changes.get(k, 50.0) for k in range(count or len(SOUND))]


UNUSABLE = [*SOUND[:BEGAN], 1200, *SOUND[BEGAN:]]
STEADY, DURING = list(range(END)), dict.fromkeys(range(BEGAN, GOOD), 99.0)
OUTSIDE_ENVELOPE = "1 estimates not finite or outside the envelope"


@pytest.mark.parametrize(
    ("episode_of", "found"),
    [
        ({"stamps": UNUSABLE}, "1 estimates of unusable samples"),
        ({"stamps": UNUSABLE, "fault": replace(SILENT, holds_s=0.25)}, ""),
        ({"stamps": [*range(BEGAN), *range(GOOD + 400, END)]}, "recovery took 0.40 s, allowed are 0.3"),
        ({"stamps": list(range(BEGAN))}, "no recovery"),
        ({"diagnoses": STATUSES[:1]}, "is not in the diagnostics"),
        (
            {"diagnoses": [*STATUSES, status(1300, "estimating; 1 unexpected errors")]},
            "estimating; 1 unexpected errors",
        ),
        ({"forces": forced({1050: 101.0})}, OUTSIDE_ENVELOPE),
        ({"forces": forced({1050: float("inf")})}, OUTSIDE_ENVELOPE),
        ({"forces": forced({1050: float("nan")})}, OUTSIDE_ENVELOPE),
        ({"forces": forced({len(SOUND) - 1: 60.0})}, "force off by 10 N"),
        ({"late_ns": 560 * MS}, "older than max_age_s"),
        ({"fault": replace(SILENT, output=TRUE)}, "no estimate for 0.50 s"),
        ({"stamps": STEADY, "fault": replace(SILENT, output=TRUE)}, ""),
        ({"stamps": STEADY, "forces": forced(DURING, END), "fault": replace(SILENT, output=BOUNDED)}, ""),
        ({"stamps": STEADY, "forces": forced(DURING, END), "fault": replace(SILENT, output=TRUE)}, "force off by 49 N"),
    ],
)
def test_what_is_wrong_with_an_episode_is_found(episode_of, found):
    if found:
        assert any(found in one for one in wrong(**episode_of))
    else:
        assert wrong(**episode_of) == ()


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
