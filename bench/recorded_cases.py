"""Data sets of the comparison on recordings, and fits of the peers to them.

The packaged rig recordings, and measured ones from the folder in CES_DATA: `dyke_mr/` (NEES-2012-1158) and `utfsm_mr/`
(vRTHS_AMBC_MRdamper). All tools get the same ticks with causal speed, position and current. Peers get them as columns
of mean 0 and standard deviation 1; "prepared" columns add the signed root of the speed and the current 8 ms ago, which
these polynomials cannot form. Blocks are joined end to end; selection data are blocks between those for
estimation.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import identification_peers as peers
import numpy as np
from identification_peers import Columns, PeerModel
from numpy.typing import NDArray

from ces_data.reading import read_log, read_recording
from ces_data.recording import Recording
from ces_identify.prepare.cost import cost, series_cost
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.prepare.series import Series, prepare
from ces_observer.model import Sampling

F = NDArray[np.float64]
Fit = Callable[[Columns, Columns], PeerModel]
Simulate = Callable[[Series], F]  # a free run: the force (ticks,) [N]

ROOT = Path(__file__).resolve().parent.parent
SHARE = 0.6  # of each measured recording for identification
LAG_S = 8e-3  # of the valve, in prepared columns
METAMSS_TICKS = 20_000  # of estimation and of selection data
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


def make_case(recordings: Sequence[Recording], row: str, delay_s: float = 0.0) -> RecordedCase:
    """Return the first SHARE of each recording for training, the rest for tests; the delay is rounded to ticks."""
    sampling = choose_sampling([recording.part(0.0, SHARE) for recording in recordings])
    sampling = replace(sampling, delay_s=round(delay_s * sampling.rate_Hz) / sampling.rate_Hz)
    whole = [prepare(recording, sampling) for recording in recordings]
    return RecordedCase(sampling, [s.part(0.0, SHARE) for s in whole], {row: [s.part(SHARE, 1.0) for s in whole]})


def dyke_case(delay_s: float = 0.0) -> RecordedCase:
    return make_case([read_measured(data_folder() / "dyke_mr" / "ranran_50.csv")], "Dyke, last 40 %", delay_s)


def utfsm_case(delay_s: float = 0.0) -> RecordedCase:
    paths = sorted((data_folder() / "utfsm_mr").glob("sweep_15Hz_*A.csv"))
    return make_case([read_measured(path) for path in paths], "UTFSM sweeps, last 40 %", delay_s)


CASES: dict[str, Callable[..., RecordedCase]] = {"rig": rig_case, "dyke": dyke_case, "utfsm": utfsm_case}
MEASURED = {"dyke": "dyke_mr/ranran_50.csv", "utfsm": "utfsm_mr"}


def data_folder() -> Path:
    return Path(os.environ.get("CES_DATA", ROOT.parent / "shared" / "data"))


def is_present(case: str) -> bool:
    """Return whether the files of a case are there."""
    return case not in MEASURED or (data_folder() / MEASURED[case]).exists()


def read_measured(log: Path) -> Recording:
    """Return a measured recording, with the mapping that is named for its folder."""
    return read_log(log, mapping=ROOT / "config" / "import" / f"{log.parent.name}.yaml")


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


@dataclass(frozen=True)
class RecordedFit:
    """A model: free run on a series, number of parameters, J [%] on the selection blocks; what the tool chose."""

    simulate: Simulate
    parameters: int
    selection_cost: float
    chosen: str = ""


@dataclass(frozen=True)
class Scale:
    """Means and standard deviations of the inputs (k,), and the RMS force [N]."""

    means: F
    deviations: F
    force_N: float


@dataclass(frozen=True)
class SeriesFeed:
    """The columns that a peer gets from a series: signals by name, see `signal_columns`."""

    signals: Sequence[str]

    def scale(self, series: Sequence[Series]) -> Scale:
        raw = np.concatenate([self.raw(one) for one in series])
        force = np.concatenate([one.force for one in series])
        return Scale(raw.mean(axis=0), raw.std(axis=0), float(np.sqrt(np.nanmean(force**2))))

    def raw(self, series: Series) -> F:
        columns = signal_columns(series)
        return np.stack([columns[name] for name in self.signals], axis=1)

    def columns(self, series: Sequence[Series], scale: Scale) -> Columns:
        """Return scaled columns of all series, one after another; ticks without a force count as force 0."""
        inputs = (np.concatenate([self.raw(one) for one in series]) - scale.means) / scale.deviations
        force = np.nan_to_num(np.concatenate([one.force for one in series])) / scale.force_N
        return Columns(inputs, force)


def signal_columns(series: Series) -> dict[str, F]:
    """Return the columns (ticks,) that a feed can name."""
    late = round(LAG_S * series.rate_Hz)
    current = np.concatenate([np.full(late, series.current[0]), series.current])[: len(series)]
    return {
        "speed": series.speed,
        "position": series.position,
        "current": series.current,
        "root": np.sign(series.speed) * np.sqrt(np.abs(series.speed)),
        "late current": current,
    }


PLAIN = SeriesFeed(("speed", "current", "position"))
PREPARED = SeriesFeed(("speed", "root", "current", "late current", "position"))


def fit_peer(fit: Fit, feed: SeriesFeed, case: RecordedCase, seconds: float) -> RecordedFit:
    """Fit on the estimation blocks and judge the free run on the selection blocks; `seconds` is not used."""
    del seconds
    blocks = cut_blocks(case.training)
    scale = feed.scale(case.training)
    model = fit(feed.columns(blocks.estimation, scale), feed.columns(blocks.selection, scale))

    def simulate(series: Series) -> F:
        force = np.full(len(series), np.nan)
        run = np.ravel(model.simulate(feed.columns([series], scale)))[: len(series)]
        force[: len(run)] = scale.force_N * run
        return force

    return RecordedFit(simulate, model.terms, blocks_cost(blocks.selection, simulate))


def metamss(estimation: Columns, selection: Columns, degree: int = 3) -> PeerModel:
    """MetaMSS on equally many ticks of both."""
    count = min(METAMSS_TICKS, len(estimation.force), len(selection.force))
    first, second = (Columns(c.inputs[:count], c.force[:count]) for c in (estimation, selection))
    return peers.metamss(first, second, degree)
