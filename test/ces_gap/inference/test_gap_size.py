"""Whether a gap is one at all: within tolerance, noise, timing or the error that references showed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ces_gap.inference.verdict import GapSize, find_no_gap_reason, is_clear_of_the_simulation, tolerance_N

SMALL = GapSize(gap_N=4.0, timed_N=4.0, noise_N=8.0, force_N=300.0, corrected=False)


@pytest.mark.parametrize(
    ("size", "improbable", "reason"),
    [
        (replace(SMALL, gap_N=2.9), False, "tolerance"),
        (SMALL, True, "noise"),
        (SMALL, False, ""),
        (replace(SMALL, gap_N=20.0, timed_N=5.0), True, "timing"),
        (replace(SMALL, gap_N=20.0, timed_N=5.0, corrected=True), True, "baseline_error"),
        (replace(SMALL, gap_N=72.0, timed_N=72.0), True, ""),
    ],
)
def test_the_reason_for_no_gap(size: GapSize, improbable: bool, reason: str) -> None:
    assert find_no_gap_reason(size, improbable, 3.0) == reason


def test_without_references_a_gap_about_as_large_as_the_noise_is_not_named() -> None:
    assert not is_clear_of_the_simulation(replace(SMALL, gap_N=10.0), 3.0)
    assert is_clear_of_the_simulation(replace(SMALL, gap_N=13.0), 3.0)
    assert is_clear_of_the_simulation(replace(SMALL, gap_N=10.0, corrected=True), 3.0)
    assert not is_clear_of_the_simulation(replace(SMALL, gap_N=13.0), 9.0)


def test_the_default_tolerance_is_small_beside_force_and_noise() -> None:
    assert tolerance_N(SMALL, None) == pytest.approx(3.0)
    assert tolerance_N(replace(SMALL, force_N=5000.0), None) == pytest.approx(16.0)
    assert tolerance_N(replace(SMALL, force_N=5000.0), 0.02) == pytest.approx(100.0)
