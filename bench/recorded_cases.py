"""Data sets of the comparison on recordings: what every tool is identified on and what it is judged on.

The packaged rig recordings, and measured ones from the folder in CES_DATA: `dyke_mr/` (NEES-2012-1158) and `utfsm_mr/`
(vRTHS_AMBC_MRdamper). All tools get the same ticks with causal speed, position and current.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ces_identify.api import read_recording
from ces_identify.preparation.cost import cost, series_cost
from ces_identify.preparation.sampling import choose_sampling
from ces_identify.preparation.series import Series, prepare
from ces_identify.recordings.recording import Channel, Recording
from ces_observer.model import Sampling

F = NDArray[np.float64]
Simulate = Callable[[Series], F]  # a free run: the force (ticks,) [N]

ROOT = Path(__file__).resolve().parent.parent
SHARE = 0.6  # of each measured recording for identification
BLOCK_S, EVERY = 2.0, 4  # every fourth block of the identification data is a peer's selection data


@dataclass(frozen=True)
class RecordedCase:
    """Training series and, by the name of a row, test series whose mean J is the figure of that row."""

    sampling: Sampling
    training: Sequence[Series]
    tests: Mapping[str, Sequence[Series]]


@dataclass(frozen=True)
class DataBlocks:
    """Pieces of the training series, each at least a warm-up long."""

    estimation: Sequence[Series]
    selection: Sequence[Series]


def rig_case() -> RecordedCase:
    """Return noise and sweep of the packaged bags for training, 4 Hz sine and road for tests."""
    noise, sweep, sine, road = (read_recording(ROOT / "bags" / n) for n in ("noise", "sweep", "sine_4hz", "road"))
    sampling = choose_sampling([noise, sweep])
    tests = {"rig, sine 4 Hz": [prepare(sine, sampling)], "rig, road": [prepare(road, sampling)]}
    return RecordedCase(sampling, [prepare(noise, sampling), prepare(sweep, sampling)], tests)


def make_case(recordings: Sequence[Recording], row: str) -> RecordedCase:
    """Return the first SHARE of each recording for training, the rest for tests."""
    sampling = choose_sampling([recording.first_part(SHARE) for recording in recordings])
    whole = [prepare(recording, sampling) for recording in recordings]
    return RecordedCase(sampling, [s.part(0.0, SHARE) for s in whole], {row: [s.part(SHARE, 1.0) for s in whole]})


def dyke_case() -> RecordedCase:
    return make_case([load_dyke(data_folder() / "dyke_mr" / "ranran_50.csv")], "Dyke, last 40 %")


def utfsm_case() -> RecordedCase:
    paths = sorted((data_folder() / "utfsm_mr").glob("sweep_15Hz_*A.csv"))
    return make_case([load_utfsm(path) for path in paths], "UTFSM sweeps, last 40 %")


CASES: dict[str, Callable[[], RecordedCase]] = {"rig": rig_case, "dyke": dyke_case, "utfsm": utfsm_case}
MEASURED = {"dyke": "dyke_mr/ranran_50.csv", "utfsm": "utfsm_mr"}


def data_folder() -> Path:
    return Path(os.environ.get("CES_DATA", ROOT.parent / "shared" / "data"))


def is_present(case: str) -> bool:
    """Return whether the files of a case are there."""
    return case not in MEASURED or (data_folder() / MEASURED[case]).exists()


def load_dyke(path: Path) -> Recording:
    rate, table = 3004.8, np.genfromtxt(path, delimiter=",", skip_header=1)
    stamps = np.rint(np.arange(len(table)) / rate * 1e9).astype(np.int64)
    return three_channels(path.stem, stamps, 0.01 * table[:, 2], table[:, 3], table[:, 6])


def load_utfsm(path: Path) -> Recording:
    table = np.genfromtxt(path, delimiter=",", names=True)
    stamps = np.rint(table["t_s"] * 1e9).astype(np.int64)
    return three_channels(path.stem, stamps, 1e-3 * table["x_mm"], table["current_A"], table["F_N"])


def three_channels(name: str, stamps: np.ndarray, position: F, current: F, force: F) -> Recording:
    values = {"position": ("m", position), "current": ("A", current), "force": ("N", force)}
    return Recording(name, {n: Channel(n, unit, stamps, v) for n, (unit, v) in values.items()})


def cut_blocks(series: Sequence[Series]) -> DataBlocks:
    """Return blocks of BLOCK_S seconds of every series, each EVERY-th of them for selection."""
    estimation: list[Series] = []
    selection: list[Series] = []
    for one in series:
        count = max(EVERY, round(len(one) / one.rate_Hz / BLOCK_S))
        for k in range(count):
            part = one.part(k / count, (k + 1) / count)
            (selection if k % EVERY == EVERY - 1 else estimation).append(part)
    return DataBlocks(estimation, selection)


def mean_cost(series: Sequence[Series], simulate: Simulate) -> float:
    """Return the mean J [%] of free runs on the scored ticks of each series."""
    return float(np.mean([series_cost(one, simulate(one)) for one in series]))


def blocks_cost(blocks: Sequence[Series], simulate: Simulate) -> float:
    """Return J [%] of the blocks together, after each block's warm-up."""
    forces = [(one.force[one.scored], simulate(one)[one.scored]) for one in blocks]
    return cost(np.concatenate([f for f, _ in forces]), np.concatenate([f for _, f in forces]))
