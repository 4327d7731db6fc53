"""SysIdentPy, fastcan and anfis-toolbox on prepared recordings: training series in, a free run on any series out.

They get the ticks of `recorded_cases` as columns of mean 0 and standard deviation 1; "prepared" columns add the signed
root of the speed and the current 8 ms ago, which these polynomials and memberships cannot form. Blocks are joined end
to end; selection data are blocks between those for estimation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import identification_peers as peers
import numpy as np
from identification_peers import Columns, PeerModel
from recorded_cases import F, RecordedCase, Simulate, blocks_cost, cut_blocks

from ces_identify.preparation.series import Series

LAG_S = 8e-3
METAMSS_TICKS = 20_000  # of estimation and of selection data

Fit = Callable[[Columns, Columns], PeerModel]


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
FUZZY, FUZZY_PREPARED = SeriesFeed(("speed", "current")), SeriesFeed(("root", "late current"))


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
