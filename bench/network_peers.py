"""Networks as peers, in PyTorch on the CPU: a GRU, a perceptron on lagged inputs, and an R2DN, contracting by its form.

They get the prepared columns and never a force, so every run is a free run. AdamW trains them on windows drawn at
random; of the networks on the way, the one with the least J on the selection blocks is kept.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from recorded_cases import PREPARED, F, RecordedCase, RecordedFit, blocks_cost, cut_blocks
from torch import Tensor, nn

from ces_identify.prepare.series import Series

LAGS_S = (0.0, 1e-3, 2e-3, 4e-3, 6e-3, 9e-3, 13e-3, 18e-3, 25e-3, 35e-3, 50e-3, 70e-3, 0.1)
STEPS, WINDOWS, SCORED, RUN_IN = 2500, 12, 300, 100  # windows of a step; ticks of a window with and without weight
CHECKS = 20  # free runs on the selection blocks
DECAY, MAX_NORM = 0.1, 1.0  # of matrices only; of the gradient
CONTRACTION = 0.999  # of the distance of two runs of the R2DN in a tick, at least

Make = Callable[[int, float], nn.Module]  # a network for so many inputs at this rate [Hz]


class Gru(nn.Module):
    """Gated units with a linear output of them and the inputs; inputs (ticks, windows, k) give (ticks, windows)."""

    rate = 1e-2  # of the first step; falls with a cosine to 0

    def __init__(self, inputs: int, rate_Hz: float, units: int = 32) -> None:
        super().__init__()
        self.reach = RUN_IN
        self.units, self.out = nn.GRU(inputs, units), nn.Linear(units + inputs, 1)

    def forward(self, inputs: Tensor) -> Tensor:
        return self.out(torch.cat([self.units(inputs)[0], inputs], -1))[..., 0]


class LaggedPerceptron(nn.Module):
    """Two layers of `units` on the inputs now and at those of LAGS_S up to `reach_s`."""

    rate = 2.5e-2

    def __init__(self, inputs: int, rate_Hz: float, units: int = 32, reach_s: float = LAGS_S[-1]) -> None:
        super().__init__()
        self.lags = sorted({round(lag * rate_Hz) for lag in LAGS_S if lag <= reach_s})
        self.reach = self.lags[-1]
        first = nn.Linear(inputs * len(self.lags), units)
        self.layers = nn.Sequential(first, nn.SiLU(), nn.Linear(units, units), nn.SiLU(), nn.Linear(units, 1))

    def forward(self, inputs: Tensor) -> Tensor:
        padded = torch.cat([inputs[:1].expand(self.reach, -1, -1), inputs])
        late = [padded[self.reach - lag : self.reach - lag + len(inputs)] for lag in self.lags]
        return self.layers(torch.cat(late, -1))[..., 0]


class R2dn(nn.Module):
    """Linear states around tanh, whose joint gain is below 1 for any parameters (Barbara, Wang & Manchester 2025).

    [next states, arguments] = gains [states, tanh] and |gains| < 1, so two runs with the same inputs draw together.
    """

    rate = 1e-2

    def __init__(self, inputs: int, rate_Hz: float, states: int = 24, units: int = 24) -> None:
        super().__init__()
        self.reach, self.states = RUN_IN, states
        poles = 1.0 - torch.logspace(-0.3, -2.3, states)
        free = 0.1 * torch.randn(states + units, states + units) / math.sqrt(states)
        free[:states, :states] = torch.diag(poles)
        self.free, self.log_scale = nn.Parameter(free), nn.Parameter(torch.zeros(units))
        self.drive, self.skip = nn.Linear(inputs, states + units), nn.Linear(states + inputs, 1)
        self.out = nn.Sequential(nn.Linear(states + inputs, units), nn.Tanh(), nn.Linear(units, 1))
        with torch.no_grad():
            self.drive.weight[:states] *= torch.sqrt(1.0 - poles**2)[:, None]

    def gains(self) -> Tensor:
        """Return the joint gains, without a loop inside a tick; a scale of each tanh does not change the proof."""
        kept = torch.ones_like(self.free)
        kept[self.states :, self.states :] = 0.0
        gains = kept * self.free
        gains = gains * (CONTRACTION / torch.linalg.matrix_norm(gains, 2).clamp(min=CONTRACTION))
        scale = torch.exp(torch.cat([torch.zeros(self.states), self.log_scale]))
        return gains * scale[:, None] / scale

    def forward(self, inputs: Tensor) -> Tensor:
        gains = self.gains()
        states = run_states(self.drive(inputs), gains[: self.states], gains[self.states :, : self.states])
        seen = torch.cat([states, inputs], -1)
        return (self.skip(seen) + self.out(seen))[..., 0]


@torch.jit.script
def run_states(drive: Tensor, forward: Tensor, back: Tensor) -> Tensor:
    """Return the states (ticks, windows, n) from rest; gains `forward` (n, n + q) and `back` (q, n)."""
    n = forward.size(0)
    state, states = torch.zeros(drive.size(1), n, dtype=drive.dtype), []
    for now in drive:
        units = torch.tanh(nn.functional.linear(state, back) + now[:, n:])
        state = nn.functional.linear(torch.cat([state, units], 1), forward) + now[:, :n]
        states.append(state)
    return torch.stack(states)


def fit_network(make: Make, case: RecordedCase, seconds: float, members: int = 1, steps: int = STEPS) -> RecordedFit:
    """Train so many networks on the estimation blocks; the run is their mean, and `seconds` is not used."""
    del seconds
    torch.set_num_threads(1)
    torch.manual_seed(1)
    blocks, scale = cut_blocks(case.training), PREPARED.scale(case.training)
    networks = [make(len(PREPARED.signals), case.sampling.rate_Hz) for _ in range(members)]

    def columns(series: Series) -> Tensor:
        rows = np.column_stack([PREPARED.columns([series], scale).inputs, series.force / scale.force_N])
        return torch.tensor(rows, dtype=torch.float32)

    def simulate(series: Series, which: Sequence[nn.Module] = networks) -> F:
        inputs = columns(series)[:, None, :-1]
        with torch.no_grad():
            runs = torch.stack([network(inputs)[:, 0] for network in which])
        return np.asarray(scale.force_N * runs.mean(0).double().numpy())

    windows = WindowDraw([columns(one) for one in blocks.estimation], networks[0].reach + SCORED)
    for one in networks:
        train(one, windows, lambda one=one: blocks_cost(blocks.selection, partial(simulate, which=[one])), steps)
    parameters = sum(p.numel() for network in networks for p in network.parameters())
    return RecordedFit(simulate, parameters, blocks_cost(blocks.selection, simulate))


class WindowDraw:
    """Windows of `length` ticks from random places of the blocks; shorter blocks are left out."""

    def __init__(self, blocks: Sequence[Tensor], length: int) -> None:
        self.blocks, self.length = [block for block in blocks if len(block) >= length], length
        self.rng = np.random.default_rng(1)

    def draw(self) -> Tensor:
        """Return WINDOWS windows (ticks, windows, k + 1), the force last."""
        chosen = [self.blocks[k] for k in self.rng.integers(len(self.blocks), size=WINDOWS)]
        starts = [int(self.rng.integers(len(block) - self.length + 1)) for block in chosen]
        return torch.stack([b[a : a + self.length] for b, a in zip(chosen, starts, strict=True)], 1)


def train(network: nn.Module, windows: WindowDraw, judge: Callable[[], float], steps: int) -> None:
    """Leave the network as it was when `judge` returned the least J."""
    matrices = [p for p in network.parameters() if p.ndim > 1]
    others = [p for p in network.parameters() if p.ndim < 2]
    groups = [{"params": matrices, "weight_decay": DECAY}, {"params": others, "weight_decay": 0.0}]
    optimiser = torch.optim.AdamW(groups, lr=network.rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    best, least = copy.deepcopy(network.state_dict()), math.inf
    for step in range(1, steps + 1):
        drawn = windows.draw()
        optimiser.zero_grad()
        error = torch.nan_to_num(network(drawn[..., :-1]) - drawn[..., -1])[-SCORED:]  # no force, no error
        error.square().mean().backward()
        nn.utils.clip_grad_norm_(network.parameters(), MAX_NORM)
        optimiser.step()
        schedule.step()
        if step % max(1, steps // CHECKS) == 0 and (cost := judge()) < least:
            best, least = copy.deepcopy(network.state_dict()), cost
    network.load_state_dict(best)


NETWORKS: dict[str, Make] = {"GRU": Gru, "lagged MLP": LaggedPerceptron, "R2DN": R2dn}
