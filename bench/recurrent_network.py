"""A gated recurrent network (GRU, PyTorch on the CPU) trained on the free-run error by truncated back-propagation.

It sees speed, signed root of speed, position and current, never a force: every run is a free run. Windows start from
a zero state; their first ticks only bring the state up. The network with the least error on the selection blocks is
kept (early stopping); the learning rate falls with the time used.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from recorded_cases import F, RecordedCase, cut_blocks
from recorded_narx import RecordedFit, Scale, SeriesFeed

from ces_identify.preparation.series import Series

FEED = SeriesFeed(("speed", "root", "position", "current"))
RUN_IN, SCORED = 80, 220  # ticks of a window: without and with a share in the error
BATCH = 64
JUDGE_EVERY = 50  # steps
RATE, LAST_SHARE = 1e-2, 0.02  # learning rate of Adam, and what is left of it at the end
MAX_NORM = 1.0  # of a gradient


def fit_network(units: int, case: RecordedCase, seconds: float) -> RecordedFit:
    """Return the network trained for `seconds` of wall time."""
    import torch

    torch.set_num_threads(1)
    torch.manual_seed(1)
    began = time.perf_counter()
    blocks, scale = cut_blocks(case.training), FEED.scale(case.training)
    network = make_network(units)
    windows = draw_windows(blocks.estimation, scale, np.random.default_rng(1))
    judged = stack_blocks(blocks.selection, scale)
    best, best_cost = train(network, windows, judged, lambda: (time.perf_counter() - began) / seconds)
    network.load_state_dict(best)
    parameters = sum(p.numel() for p in network.parameters())
    return RecordedFit(partial(simulate, network, scale), parameters, best_cost)


def make_network(units: int) -> Any:
    """Return a GRU of `units` states whose output is linear in state and inputs."""
    import torch

    class Network(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.gru = torch.nn.GRU(len(FEED.signals), units, batch_first=True)
            self.out = torch.nn.Linear(units + len(FEED.signals), 1)

        def forward(self, inputs: Any) -> Any:
            states, _ = self.gru(inputs)
            return self.out(torch.cat([states, inputs], dim=-1))[..., 0]

    return Network()


def draw_windows(series: Sequence[Series], scale: Scale, rng: np.random.Generator) -> Any:
    """Yield batches for ever: inputs (BATCH, ticks, k), force and weights (BATCH, ticks), without ticks not scored."""
    import torch

    length = RUN_IN + SCORED
    data = [(FEED.columns([one], scale), np.isfinite(one.force).astype(float)) for one in series if len(one) > length]
    sizes = np.array([len(weights) - length for _, weights in data], dtype=float)
    while True:
        chosen = rng.choice(len(data), BATCH, p=sizes / sizes.sum())
        starts = [rng.integers(0, int(sizes[k]) + 1) for k in chosen]
        cuts = [(data[k][0], data[k][1], slice(a, a + length)) for k, a in zip(chosen, starts, strict=True)]
        arrays = [[c.inputs[at] for c, _, at in cuts], [c.force[at] for c, _, at in cuts], [w[at] for _, w, at in cuts]]
        inputs, force, weights = (torch.tensor(np.stack(a), dtype=torch.float32) for a in arrays)
        weights[:, :RUN_IN] = 0.0
        yield inputs, force, weights


def stack_blocks(series: Sequence[Series], scale: Scale) -> Any:
    """Return inputs, force and weights of whole blocks, cut to the shortest."""
    import torch

    length = min(len(one) for one in series)
    columns = [FEED.columns([one], scale) for one in series]
    stacks = [[c.inputs[:length] for c in columns], [c.force[:length] for c in columns]]
    stacks.append([one.scored[:length].astype(float) for one in series])
    return tuple(torch.tensor(np.stack(a), dtype=torch.float32) for a in stacks)


def train(network: Any, windows: Any, judged: Any, used: Any) -> tuple[Any, float]:
    """Return the state with the least J [%] on the `judged` blocks, and that J; `used` is the share of the time."""
    import torch

    optimiser = torch.optim.Adam(network.parameters(), lr=RATE)
    best, best_cost, step = copy.deepcopy(network.state_dict()), math.inf, 0
    while (share := used()) < 1.0:
        for group in optimiser.param_groups:
            group["lr"] = RATE * (LAST_SHARE + (1.0 - LAST_SHARE) * 0.5 * (1.0 + math.cos(math.pi * share)))
        optimiser.zero_grad()
        squared_error(network, *next(windows)).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), MAX_NORM)
        optimiser.step()
        step += 1
        if step % JUDGE_EVERY == 0 and (j := block_cost(network, *judged)) < best_cost:
            best, best_cost = copy.deepcopy(network.state_dict()), j
    return best, best_cost


def squared_error(network: Any, inputs: Any, force: Any, weights: Any) -> Any:
    """Return the weighted mean square of the free-run error."""
    return (weights * (network(inputs) - force) ** 2).sum() / weights.sum()


def block_cost(network: Any, inputs: Any, force: Any, weights: Any) -> float:
    """Return J [%] on the weighted ticks."""
    import torch

    with torch.no_grad():
        mean = (weights * force).sum() / weights.sum()
        spread = (weights * (force - mean) ** 2).sum() / weights.sum()
        return 100.0 * math.sqrt(float(squared_error(network, inputs, force, weights) / spread))


def simulate(network: Any, scale: Scale, series: Series) -> F:
    """Return the free run [N] on a series, from a zero state at each segment."""
    import torch

    inputs = torch.tensor(FEED.columns([series], scale).inputs, dtype=torch.float32)
    force = np.full(len(series), np.nan)
    with torch.no_grad():
        for start, stop in series.segments:
            force[start:stop] = scale.force_N * network(inputs[None, start:stop])[0].numpy()
    return force
