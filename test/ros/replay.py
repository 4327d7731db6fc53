"""Samples to replay to a node, and what an estimator that is fed them in order makes of them."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nan

from damper_models import plain_damper
from sensor_msgs.msg import JointState
from vehicle import Vehicle, stamp_of, stroke, wait

from ces_observer.current_hold import ConstantCurrent, CurrentHold
from ces_observer.estimator import Estimator
from ces_observer.model import Model

MS, S = 1_000_000, 1_000_000_000
START_NS = 1_000_000_000_000_000_000
Samples = Sequence[tuple[int, float]]  # (stamp [ns], value)
Numbers = tuple[float, float, float]  # position [m], speed [m/s], force [N]


def jittered_positions(count: int) -> Samples:
    """Return positions [m] at 1 kHz with jitter, lost and repeated samples, an outlier and a NaN."""
    chance = random.Random(1)
    samples = [(START_NS + k * MS + chance.randrange(MS // 2), stroke(k * 1e-3)) for k in range(count)]
    samples[500] = (samples[500][0], nan)
    samples[600] = (samples[600][0], 0.09)
    samples[700] = samples[699]
    return samples[:800] + samples[820:]


def currents(count: int) -> Samples:
    """Return currents [A] each 10 ms, none equal to the one before, up to after the last of `count` positions."""
    return [(START_NS + 10 * k * MS, 0.5 + 0.2 * (k % 7)) for k in range(count // 10 + 2)]


# Of the stamps' clock before each segment, by fractions of a tick, so that the grid of ticks moves: the first ones are
# longer than what a model bridges, or than what a hold of currents keeps; the last two are shorter.
JUMPS_NS = (0, 30 * S + 400_321, -7_300_401_007, -100_300_009, 150_200_005)
SEGMENT_MS = 700


@dataclass(frozen=True)
class Segment:
    """Samples between two jumps of their clock, in the order in which they are sent on each topic."""

    positions: Samples
    currents: Samples


def faulty_segments() -> list[Segment]:
    """Return segments with jitter, gaps, repeated and late stamps, wrong numbers and lost currents."""
    chance, begin_ns = random.Random(5), START_NS
    segments = []
    for jump_ns in JUMPS_NS:
        segments.append(_make_segment(begin_ns + jump_ns, chance))
        begin_ns = segments[-1].positions[-1][0]
    return segments


def _make_segment(begin_ns: int, chance: random.Random) -> Segment:
    samples = [(begin_ns + k * MS + chance.randrange(MS // 2), stroke(k * 1e-3)) for k in range(SEGMENT_MS)]
    for at, value in ((250, nan), (260, inf), (261, -inf), (330, 0.09), (331, 1e308)):
        samples[at] = (samples[at][0], value)
    samples[350] = samples[349]
    samples[355] = (samples[352][0] + 1, samples[355][1])
    ticks = range(begin_ns // (10 * MS), (samples[-1][0] + 20 * MS) // (10 * MS))
    held = [(10 * k * MS, 0.5 + 0.2 * (k % 7)) for k in ticks]  # the same at the same time, on whichever side of a jump
    held[40], held[45] = (held[40][0], nan), (held[45][0], inf)
    return Segment(samples[:300] + samples[320:], held[:10] + held[30:])


class Offline:
    """An estimator that is fed samples in order, with the current held as a node holds it."""

    def __init__(self, model: Model | None = None, current: CurrentHold | None = None) -> None:
        self._estimator = Estimator(model or plain_damper(max_gap_s=0.3))
        sampling = self._estimator.model.sampling
        self.half_widths: dict[int, float | None] = {}  # of the bands [N] of all forces so far
        self._current = current or CurrentHold(sampling.max_current_age_s)
        self._motion = CurrentHold(sampling.max_gap_s) if sampling.motion else ConstantCurrent(0.0)

    def take(self, positions: Samples, currents: Samples = (), motions: Samples = ()) -> dict[int, Numbers]:
        """Return position, speed and force by stamp; each position has the currents and motions stamped up to it."""
        for hold, samples in ((self._current, currents), (self._motion, motions)):
            for sample in samples:
                hold.add(*sample)
        estimator, found = self._estimator, {}
        for stamp, position in positions:
            force = estimator.step(stamp, position, self._current.at(stamp), self._motion.at(stamp))
            if force is not None:
                found[stamp] = (estimator.position, estimator.speed, force)
                self.half_widths[stamp] = estimator.half_width()
            found |= {one.stamp_ns: (one.position, one.speed, one.force) for one in estimator.late}
            self.half_widths |= {one.stamp_ns: one.half_width for one in estimator.late}
        return found


def numbers_of(message: JointState) -> Numbers:
    """Return position, speed and force of an estimate."""
    return message.position[0], message.velocity[0], message.effort[0]


def require_equal(vehicle: Vehicle, expected: dict[int, Numbers]) -> None:
    """Wait for the estimates of `expected`, and for no others: stamps and numbers are the same, bit for bit."""
    wait(lambda: len(vehicle.estimates) >= len(expected), "all estimates")
    assert [(stamp_of(message), numbers_of(message)) for message in vehicle.estimates] == list(expected.items())
    assert len(expected) > 1500
    assert max(abs(force) for _, _, force in expected.values()) > 100.0
