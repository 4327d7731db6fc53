"""Networks as peers, in PyTorch on the CPU: gated recurrent units (GRU), and perceptrons on lagged inputs.

They never get a force, so every run is a free run; a model is the mean of MEMBERS of them. AdamW trains these side by
side on windows drawn at random. With selection blocks, the step with the least J on them is kept, and a refit ends
there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import deepcopy
from functools import partial

import numpy as np
import torch
from torch import Tensor, nn

from bench.measured.regressions import PeerModel, lag_ticks
from bench.measured.ticks import Feed, pooled_cost
from ces_data.arrays import F
from ces_identify.prepare.series import Series

MEMBERS = 3
STEPS, WINDOWS, SCORED, RUN_IN = 400, 64, 200, 100  # windows of a step; ticks of a window with and without weight
CHECKS = 20  # free runs on the selection blocks
DECAY, MAX_NORM = 0.1, 1.0  # of matrices only; of the gradient

Make = Callable[[int, float], nn.Module]  # networks for so many inputs at this rate [Hz]


class Grus(nn.Module):
    """GRUs of `units`, each with a linear output of them and the inputs; all are blocks of one matrix.

    A product of this size costs no more time than a block. Inputs (ticks, windows, k) give (ticks, windows, members).
    """

    step = 1e-2  # the first; falls with a cosine to 0

    def __init__(self, inputs: int, rate_Hz: float, units: int) -> None:
        super().__init__()
        networks = [nn.GRU(inputs, units) for _ in range(MEMBERS)]
        drive, back = (
            torch.stack([getattr(one, name).view(3, units, -1) for one in networks], 1)
            for name in ("weight_ih_l0", "weight_hh_l0")
        )
        self.drive = nn.Parameter(drive.detach().flatten(0, 2))
        self.back = nn.Parameter(back.detach())  # (gates, members, units, units)
        self.levels = nn.Parameter(torch.zeros(2 * len(self.drive)))
        self.out = nn.ModuleList(nn.Linear(units + inputs, 1) for _ in range(MEMBERS))

    def forward(self, inputs: Tensor) -> Tensor:
        back = torch.cat([torch.block_diag(*gate) for gate in self.back])
        rest = torch.zeros(1, inputs.shape[1], back.shape[1])
        weights = [self.drive, back, *self.levels.chunk(2)]
        states = torch.gru(inputs, rest, weights, True, 1, 0.0, False, False, False)[0].chunk(MEMBERS, -1)
        return torch.cat([out(torch.cat([own, inputs], -1)) for out, own in zip(self.out, states, strict=True)], -1)


class Perceptrons(nn.Module):
    """Perceptrons with two layers of 32 units on the inputs at lags up to `reach_s`."""

    step = 2.5e-2

    def __init__(self, inputs: int, rate_Hz: float, reach_s: float, units: int = 32) -> None:
        super().__init__()
        self.lags = lag_ticks(reach_s, rate_Hz)
        first = [nn.Linear(inputs * len(self.lags), units) for _ in range(MEMBERS)]
        self.members = nn.ModuleList(
            nn.Sequential(one, nn.SiLU(), nn.Linear(units, units), nn.SiLU(), nn.Linear(units, 1)) for one in first
        )

    def forward(self, inputs: Tensor) -> Tensor:
        reach = self.lags[-1]
        padded = torch.cat([inputs[:1].expand(reach, -1, -1), inputs])
        late = torch.cat([padded[reach - lag : reach - lag + len(inputs)] for lag in self.lags], -1)
        return torch.cat([member(late) for member in self.members], -1)


def lagged_perceptron(
    estimation: Sequence[Series], selection: Sequence[Series], reach_s: float, signals: Sequence[str]
) -> PeerModel:
    return fit_networks(estimation, selection, partial(Perceptrons, reach_s=reach_s), signals)


def fit_networks(
    estimation: Sequence[Series], selection: Sequence[Series], make: Make, signals: Sequence[str], steps: int = STEPS
) -> PeerModel:
    """Train networks for `steps`, or with selection data for those that are best."""
    torch.set_num_threads(1)
    torch.manual_seed(1)
    feed = Feed.of(signals, estimation)
    networks = make(len(signals), estimation[0].rate_Hz)

    def tensor(series: Series) -> Tensor:
        columns = feed.columns([series])
        return torch.tensor(np.column_stack([columns.inputs, columns.force]), dtype=torch.float32)

    def simulate(series: Series) -> F:
        with torch.no_grad():
            runs = networks(tensor(series)[:, None, :-1])[:, 0]
        return np.asarray(feed.force_N * runs.mean(-1).double().numpy())

    evaluate = partial(pooled_cost, selection, simulate) if selection else None
    best = train(networks, [tensor(one) for one in estimation], evaluate, steps)
    return PeerModel(simulate, lambda data: fit_networks(data, [], make, signals, best))


def draw_windows(blocks: Sequence[Tensor], random: np.random.Generator) -> Tensor:
    """Return WINDOWS windows (ticks, windows, k + 1) from random places, no longer than the shortest block."""
    lengths = np.array([len(block) for block in blocks])
    length = min(RUN_IN + SCORED, *lengths)
    chosen = random.choice(len(blocks), WINDOWS, p=lengths / lengths.sum())
    starts = random.integers(lengths[chosen] - length + 1)
    return torch.stack([blocks[k][a : a + length] for k, a in zip(chosen, starts, strict=True)], 1)


def train(networks: nn.Module, blocks: Sequence[Tensor], evaluate: Callable[[], float] | None, steps: int) -> int:
    """Leave the networks as they were at the step with the least J, or at the last one; return the step."""
    matrices = [p for p in networks.parameters() if p.ndim > 1]
    others = [p for p in networks.parameters() if p.ndim < 2]
    groups = [{"params": matrices, "weight_decay": DECAY}, {"params": others, "weight_decay": 0.0}]
    optimiser = torch.optim.AdamW(groups, lr=networks.step)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS)
    best, least, end, random = deepcopy(networks.state_dict()), math.inf, steps, np.random.default_rng(1)
    for step in range(1, steps + 1):
        drawn = draw_windows(blocks, random)
        optimiser.zero_grad()
        error = torch.nan_to_num(networks(drawn[..., :-1]) - drawn[..., -1:])[RUN_IN:]  # no force, no error
        error.square().sum(-1).mean().backward()
        nn.utils.clip_grad_norm_(networks.parameters(), MAX_NORM)
        optimiser.step()
        schedule.step()
        if evaluate and step % (STEPS // CHECKS) == 0 and (cost := evaluate()) < least:
            best, least, end = deepcopy(networks.state_dict()), cost, step
    if evaluate:
        networks.load_state_dict(best)
    return end
