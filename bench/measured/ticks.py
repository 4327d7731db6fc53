"""A measured case on its ticks: causal speed, position and current from our estimator, and the columns that peers get.

All tools get these ticks. Blocks of the training data, left out of a first fit, choose a peer's setting.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.measured.cases import MeasuredCase
from ces_data.arrays import F
from ces_data.samples import without_spikes
from ces_identify.prepare.cost import cost, series_cost
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.prepare.series import Series, prepare
from ces_observer.model import Sampling

Simulate = Callable[[Series], F]  # a free run: the force (ticks,) [N]

WARM_UP_S = 0.5  # [s] of a series that no tool is scored on
BLOCK_S, BLOCK_TICKS, EVERY = 2.0, 400, 4  # the least length of a block; one of so many is for selection
VALVE_S = 8e-3  # [s] by which the late current is late


@dataclass(frozen=True)
class TickCase:
    """Series to identify on, and series to test on by their names."""

    sampling: Sampling
    training: Sequence[Series]
    tests: Mapping[str, Series]

    def test_cost(self, simulate: Simulate) -> float:
        """Return the mean J [%] of free runs on the test series."""
        return float(np.mean([series_cost(one, simulate(one)) for one in self.tests.values()]))


def prepare_case(case: MeasuredCase) -> TickCase:
    """Return a case on its ticks."""
    sampling = choose_sampling([without_spikes(recording) for recording in case.identification])
    sampling = replace(sampling, warm_up_s=WARM_UP_S)
    tests = {name: prepare(recording, sampling) for name, recording in case.tests.items()}
    return TickCase(sampling, [prepare(recording, sampling) for recording in case.identification], tests)


def cut_blocks(training: Sequence[Series]) -> tuple[list[Series], list[Series]]:
    """Return the blocks of the series for estimation and for selection, each at least BLOCK_S long, EVERY at least."""
    estimation: list[Series] = []
    selection: list[Series] = []
    for series in training:
        count = max(EVERY, int(len(series) / max(BLOCK_TICKS, BLOCK_S * series.rate_Hz)))
        for k in range(count):
            part = series.part(k / count, (k + 1) / count)
            (selection if k % EVERY == EVERY - 1 else estimation).append(part)
    return estimation, selection


def pooled_cost(blocks: Sequence[Series], simulate: Simulate) -> float:
    """Return J [%] of the scored ticks of the blocks together."""
    forces = [(one.force[one.scored], simulate(one)[one.scored]) for one in blocks]
    return cost(np.concatenate([f for f, _ in forces]), np.concatenate([f for _, f in forces]))


@dataclass(frozen=True)
class Columns:
    """Inputs (ticks, k), one column each, and the measured force (ticks,); all scaled."""

    inputs: F
    force: F


@dataclass(frozen=True)
class Feed:
    """Scaled columns of series: named signals of mean 0 and deviation 1, and the force over its RMS `force_N` [N]."""

    signals: Sequence[str]
    means: F
    deviations: F
    force_N: float

    @classmethod
    def of(cls, signals: Sequence[str], series: Sequence[Series]) -> Feed:
        """Return the feed whose scales are those of the series; a signal that is constant becomes 0."""
        raw = np.concatenate([read_signals(one, signals) for one in series])
        deviations = raw.std(axis=0)
        deviations[deviations < 1e-9 * (1.0 + np.abs(raw).max(axis=0))] = np.inf
        force = np.concatenate([one.force for one in series])
        return cls(signals, raw.mean(axis=0), deviations, float(np.sqrt(np.nanmean(force**2))))

    def columns(self, series: Sequence[Series]) -> Columns:
        """Return the columns of series, one after another; ticks without a force have NaN."""
        inputs = np.concatenate([read_signals(one, self.signals) for one in series])
        force = np.concatenate([one.force for one in series])
        return Columns((inputs - self.means) / self.deviations, force / self.force_N)


def read_signals(series: Series, names: Sequence[str]) -> F:
    """Return the signals (ticks, k) that a feed can name."""
    late = round(VALVE_S * series.rate_Hz)
    known = {
        "speed": series.speed,
        "position": series.position,
        "current": series.current,
        "root": np.sign(series.speed) * np.sqrt(np.abs(series.speed)),
        "late current": np.concatenate([np.full(late, series.current[0]), series.current])[: len(series)],
    }
    return np.stack([known[name] for name in names], axis=1)
