"""Ticks of trained structures: the same bits in CPython and Numba, and never beside their arrays."""

import math
import random

import numpy as np
import pytest
from mixture_models import mixture_model
from recurrent_models import make_recurrent, recurrent_model
from trained_models import FUZZY, NETWORK, experts_model, fuzzy_model, network_model, random_fuzzy, random_network

from ces_identify.structures import run_batch
from ces_observer.tick.mixture import check_structure
from ces_observer.tick.model import HELD

MODELS = {
    "sigmoid": network_model,
    "fuzzy": fuzzy_model,
    "recurrent": recurrent_model,
    "mixture": mixture_model,
    "experts": experts_model,
    "recurrent, no current": lambda: recurrent_model(make_recurrent(3, 1, current=False)),
    **{f"sigmoid {seed}": lambda seed=seed: random_network(random.Random(seed)) for seed in range(4)},
    **{f"experts {seed}": lambda seed=seed: experts_model(random.Random(seed)) for seed in range(4)},
    **{f"fuzzy {seed}": lambda seed=seed: random_fuzzy(random.Random(seed)) for seed in range(4)},
    **{f"recurrent {seed}": lambda seed=seed: recurrent_model(make_recurrent(seed)) for seed in range(4, 8)},
}
HOSTILE = (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0)
SEGMENT = 40  # ticks


def hostile_inputs(model, ticks=2000):
    """Inputs (3, ticks) within and beyond the envelope, with a value of HOSTILE in some."""
    dice = np.random.default_rng(1)
    rows = np.stack([dice.uniform(low - 0.2, high + 0.2, ticks) for low, high in model.envelope.by_signal.values()])
    at = dice.random(rows.shape) < 0.01
    rows[at] = dice.choice(HOSTILE, at.sum())
    return rows


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS)
def test_the_desk_computes_the_vehicles_bits(make):
    model = make()
    inputs, arrays = hostile_inputs(model), model.body.lay_out(model.operating_range).arrays()
    reset, tick = model.body.runs  # the source, whatever is compiled
    starts = np.arange(0, inputs.shape[1], SEGMENT)
    force, held = run_batch(model, inputs, np.stack([starts, starts + SEGMENT], axis=1))
    expected = np.full(len(force), math.nan)
    for start in starts:
        reset(*arrays)
        for k in range(start, start + SEGMENT):
            y = tick(*arrays, *inputs[:, k].tolist())
            if not math.isfinite(y):
                break
            expected[k] = y
            assert held[k] == (arrays.k[HELD] != 0)
    assert 0.4 < np.isfinite(expected).mean() < 1.0
    assert force.tobytes() == expected.tobytes()


class Guarded(list):
    """A list that refuses an index from the end."""

    def __getitem__(self, place):
        assert place >= 0
        return super().__getitem__(place)

    def __setitem__(self, place, value):
        assert place >= 0
        super().__setitem__(place, value)


@pytest.mark.parametrize("make", list(MODELS.values())[:5], ids=list(MODELS)[:5])
def test_what_passes_the_check_stays_within_its_arrays(make):
    model, dice = make(), random.Random(2)
    arrays = model.body.lay_out(model.operating_range).arrays()
    sizes = [len(array) for array in arrays]
    assert check_structure(*arrays[:2], *sizes)
    assert not any(check_structure(*arrays[:2], *(n - (i == j) for j, n in enumerate(sizes))) for i in range(3))
    passed = 0
    for _ in range(3000):
        p, n, s, k = (Guarded(array) for array in arrays)
        n[dice.randrange(3, len(n))] = dice.choice((-1, 0, 1, 2, 3, 50, 2**31, dice.randrange(200)))
        if check_structure(p, n, *sizes):
            passed += 1
            model.body.runs[0](p, n, s, k)
            for _ in range(3):
                model.body.runs[1](p, n, s, k, 0.01, dice.uniform(-1, 1), 0.4)
    assert passed > 100


@pytest.mark.parametrize("body", [NETWORK, FUZZY], ids=["sigmoid", "fuzzy"])
def test_a_spread_of_zero_is_refused(body):
    model = network_model(body)
    p, n, *_ = arrays = model.body.lay_out(model.operating_range).arrays()
    at = p.index(body.regressors[3].spread)
    assert not check_structure([*p[:at], 0.0, *p[at + 1 :]], n, *map(len, arrays))
