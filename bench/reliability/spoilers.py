"""Faults of the source: each spoiler changes the messages of a tick while its episode lasts.

A spoiler is a function of a tick; the functions here make one from a random generator (`dice`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf, nan
from random import Random

from ride import MS, stroke_m
from wire import JOINT

OTHER_JOINT = "front_damper"
POSITION, CURRENT = "joint_states", "valve_current"


@dataclass(frozen=True)
class PositionSample:
    """One position to be published."""

    stamp_ns: int
    position_m: float
    joint: str = JOINT


@dataclass
class RideTick:
    """The messages of one tick; None: no current, or no clock in simulated time."""

    samples: list[PositionSample]
    current_A: float | None
    now_ns: int | None
    garbage_on: list[str] = field(default_factory=list)


Spoiler = Callable[[RideTick], None]


def nothing(dice: Random) -> Spoiler:
    return lambda tick: None


def silence(dice: Random) -> Spoiler:
    return lambda tick: tick.samples.clear()


def dropouts(min_count: int, max_count: int) -> Callable[[Random], Spoiler]:
    """Make spoilers that lose rows of `min_count` to `max_count` samples, with as many in between."""

    def make(dice: Random) -> Spoiler:
        left = [0, False]

        def spoil(tick: RideTick) -> None:
            if left[0] == 0:
                left[:] = dice.randint(min_count, max_count), not left[1]
            left[0] -= 1
            if left[1]:
                tick.samples.clear()

        return spoil

    return make


def duplicates(dice: Random) -> Spoiler:
    def spoil(tick: RideTick) -> None:
        tick.samples *= dice.randint(1, 3)

    return spoil


def reordering(dice: Random) -> Spoiler:
    """Publish four samples at a time, in any order."""
    held: list[PositionSample] = []

    def spoil(tick: RideTick) -> None:
        held.extend(tick.samples)
        tick.samples.clear()
        if len(held) >= 4:
            dice.shuffle(held)
            tick.samples.extend(held)
            held.clear()

    return spoil


def positions(value: Callable[[PositionSample, Random], float], share: float = 1.0) -> Callable[[Random], Spoiler]:
    """Make spoilers that replace a share of the positions by another value."""

    def make(dice: Random) -> Spoiler:
        def spoil(tick: RideTick) -> None:
            tick.samples[:] = [
                replace(one, position_m=value(one, dice)) if dice.random() < share else one for one in tick.samples
            ]

        return spoil

    return make


def freeze_position(dice: Random) -> Spoiler:
    frozen: list[float] = []

    def spoil(tick: RideTick) -> None:
        frozen.extend(one.position_m for one in tick.samples[: not frozen])
        tick.samples[:] = [replace(one, position_m=frozen[0]) for one in tick.samples]

    return spoil


def currents(value: float | None) -> Callable[[Random], Spoiler]:
    def make(dice: Random) -> Spoiler:
        def spoil(tick: RideTick) -> None:
            tick.current_A = value

        return spoil

    return make


def stamps_off(min_s: float, max_s: float, sign: int, clock_too: bool = False) -> Callable[[Random], Spoiler]:
    """Make spoilers that set the stamps, and with `clock_too` the simulated time as well, off by a constant."""

    def make(dice: Random) -> Spoiler:
        off_ns = sign * MS * dice.randint(round(min_s * 1e3), round(max_s * 1e3))

        def spoil(tick: RideTick) -> None:
            tick.samples[:] = [replace(one, stamp_ns=one.stamp_ns + off_ns) for one in tick.samples]
            if clock_too and tick.now_ns is not None:
                tick.now_ns += off_ns

        return spoil

    return make


def clock_off(dice: Random) -> Spoiler:
    off_ns = dice.choice((-1, 1)) * MS * dice.randint(2_000, 60_000)

    def spoil(tick: RideTick) -> None:
        if tick.now_ns is not None:
            tick.now_ns += off_ns

    return spoil


def pause(dice: Random) -> Spoiler:
    def spoil(tick: RideTick) -> None:
        tick.samples.clear()
        tick.current_A = tick.now_ns = None

    return spoil


def wrong_joint(dice: Random) -> Spoiler:
    def spoil(tick: RideTick) -> None:
        tick.samples[:] = [replace(one, joint=OTHER_JOINT) for one in tick.samples]

    return spoil


def flood(dice: Random) -> Spoiler:
    """Publish true samples at ten times the rate."""

    def spoil(tick: RideTick) -> None:
        stamps = [one.stamp_ns - k * MS // 10 for one in tick.samples for k in range(9, -1, -1)]
        tick.samples[:] = [PositionSample(stamp, stroke_m(stamp)) for stamp in stamps]

    return spoil


def garbage(instead: bool, *topics: str) -> Callable[[Random], Spoiler]:
    """Make spoilers that publish invalid bytes, among good messages or instead of them."""

    def make(dice: Random) -> Spoiler:
        def spoil(tick: RideTick) -> None:
            if instead:
                tick.samples.clear()
                tick.current_A = None
            tick.garbage_on.extend(topic for topic in topics if instead or dice.random() < 0.3)

        return spoil

    return make


def _spike(one: PositionSample, dice: Random) -> float:
    return one.position_m + dice.choice((-1.0, 1.0)) * dice.uniform(0.2, 1.0)


SPOILERS: dict[str, Callable[[Random], Spoiler]] = {
    "nothing": nothing,
    "silence": silence,
    "short dropouts": dropouts(1, 5),
    "long dropouts": dropouts(20, 100),
    "duplicates": duplicates,
    "reordering": reordering,
    "nan": positions(lambda one, dice: nan),
    "some nan": positions(lambda one, dice: nan, 0.2),
    "inf": positions(lambda one, dice: dice.choice((inf, -inf))),
    "huge": positions(lambda one, dice: dice.choice((-1e300, 1e300))),
    "spikes": positions(_spike, 0.02),
    "stuck": freeze_position,
    "no current": currents(None),
    "nan current": currents(nan),
    "inf current": currents(inf),
    "huge current": currents(1e300),
    "ahead": stamps_off(2.0, 60.0, 1),
    "behind": stamps_off(2.0, 60.0, -1),
    "a little ahead": stamps_off(0.1, 0.4, 1),
    "a little behind": stamps_off(0.1, 0.4, -1),
    "time ahead": stamps_off(2.0, 60.0, 1, clock_too=True),
    "time behind": stamps_off(2.0, 60.0, -1, clock_too=True),
    "clock alone": clock_off,
    "paused": pause,
    "wrong joint": wrong_joint,
    "flood": flood,
    "garbage among": garbage(False, POSITION, CURRENT),
    "garbage": garbage(True, POSITION, CURRENT),
}
