"""The comparison of speed estimates: filters that find a speed, and costs that are those of the speed alone."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "bench"))

import bench_speed
from speed_peers import PEERS

RATE = 1000.0
TIME = np.arange(4000) / RATE
OMEGA = 2.0 * np.pi * 2.0


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_a_peer_finds_the_speed_of_its_own_sample(peer) -> None:
    stroke, speed = 0.02 * np.sin(OMEGA * TIME), 0.02 * OMEGA * np.cos(OMEGA * TIME)
    errors = [np.std((peer.speeds(stroke, RATE, setting) - speed)[1000:-10]) / np.std(speed) for setting in peer.grid]
    assert min(errors) < 0.06


def test_only_the_true_speed_costs_nothing() -> None:
    motion = bench_speed.load_packaged(["sine_4hz"])[0]
    true = bench_speed.costs([motion], lambda one: (bench_speed.TIME_S, one.speed_m_s))
    late = bench_speed.costs([motion], lambda one: (bench_speed.TIME_S + 2e-3, one.speed_m_s))
    np.testing.assert_allclose(true, 0.0, atol=1e-9)
    assert (late > 1.0).all() and (late < 10.0).all()
    assert bench_speed.ratios(late, late) == "1.00/1.00"
