"""Rare deviations: events of ten times the noise are found with their place, clean and coloured noise has none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from engine_plant import traced
from scipy.signal import lfilter

from ces_data.arrays import F
from ces_gap.inference.rare import RareDeviation, find_rare_deviation
from ces_gap.limits import RareLimits
from ces_gap.trace import Trace

NOISE_N, SECONDS = 6.0, 20.0
PLAIN = traced(seed=1, seconds=SECONDS)


def measured(seed: int, colour: float = 0.0, spread: float = 0.0) -> Trace:
    """Return the trace with noise, coloured or of a level that changes from time to time, on its exact simulation."""
    rng = np.random.default_rng(seed)
    noise = lfilter([np.sqrt(1.0 - colour**2)], [1.0, -colour], rng.standard_normal(len(PLAIN)))
    level = NOISE_N * (1.0 + spread * np.sin(2.0 * np.pi * PLAIN.time_s / 3.0))
    return replace(PLAIN, name=f"made{seed}", force=PLAIN.simulated + level * noise)


def hit(trace: Trace, at_s: float, size_N: float, width_s: float) -> Trace:
    inside = (trace.time_s >= at_s) & (trace.time_s < at_s + width_s)
    return replace(trace, force=trace.force + size_N * inside)


def find(traces: Sequence[Trace], known: Sequence[F] = (), least_N: float = 0.0) -> RareDeviation | None:
    return find_rare_deviation(traces, [t.simulated for t in traces], known, least_N)


@pytest.mark.parametrize(("size", "width_s"), [(10.0, 0.02), (-10.0, 0.02), (14.0, 0.01), (3.0, 0.3)])
def test_an_event_in_a_thousandth_of_the_time_is_found_with_its_place(size: float, width_s: float) -> None:
    places = np.random.default_rng(4).uniform(1.0, SECONDS - 2.0, 20)
    events = [find([hit(measured(k), at, size * NOISE_N, width_s), measured(99)]) for k, at in enumerate(places)]
    seen = [event for event in events if event is not None and np.sign(event.mean_N) == np.sign(size)]
    assert len(seen) >= 19
    for k, (event, at_s) in enumerate(zip(events, places, strict=True)):
        assert event is None or (event.recording == f"made{k}" and at_s - 0.2 < event.time_s < at_s + width_s + 0.2)


@pytest.mark.parametrize(("colour", "spread"), [(0.0, 0.0), (0.9, 0.0), (0.0, 0.5)])
def test_clean_recordings_have_none(colour: float, spread: float) -> None:
    events = [find([measured(2 * k, colour, spread), measured(2 * k + 1, colour, spread)]) for k in range(50)]
    assert sum(event is not None for event in events) <= 1


def test_what_is_immaterial_known_or_too_short_is_none() -> None:
    struck = hit(measured(1), 7.0, 80.0, 0.03)
    assert find([struck]) is not None and find([struck], least_N=100.0) is None
    assert find([struck], [(struck.force - struck.simulated)]) is None  # references show as much
    short = replace(struck, usable=struck.usable & (np.abs(struck.time_s - 7.0) < 0.2 * RareLimits.MIN_BLOCKS))
    assert find([short]) is None
    assert find([replace(struck, usable=np.zeros(len(struck), bool))]) is None
