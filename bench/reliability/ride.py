"""The ride, its messages as bytes, and the spoilers, which change the messages of a tick while an episode lasts.

Bytes reach 10 kHz from Python and can be invalid; their layouts come from messages serialised by the middleware's own
code, not by this project's. A spoiler is a function of a tick, made from a random generator (dice).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf, nan, pi, sin
from random import Random

from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from ces_observer.estimator import Estimator
from ces_observer.model import Model

MS = 1_000_000  # [ns]
PERIOD_MS = 2000
RATE_HZ = 1000


def stroke_m(stamp_ns: int) -> float:
    """Return the position: 20 mm at 2 Hz and 1 mm at 12.5 Hz, at most 0.33 m/s."""
    time_s = stamp_ns % (PERIOD_MS * MS) * 1e-9
    return 0.02 * sin(2.0 * pi * 2.0 * time_s) + 0.001 * sin(2.0 * pi * 12.5 * time_s)


def current_A(stamp_ns: int) -> float:
    """Return the current, which is slow because its samples have no stamps and vary in age by a millisecond."""
    return 0.5 + 0.05 * sin(2.0 * pi * 0.5 * (stamp_ns % (PERIOD_MS * MS)) * 1e-9)


class TrueForce:
    """The force [N] by stamp of an estimator that received every sample."""

    def __init__(self, model: Model) -> None:
        estimator = Estimator(model)
        beginning = PERIOD_MS * (1 + int(model.sampling.warm_up_s * 1000 / PERIOD_MS))
        forces = [estimator.step(k * MS, stroke_m(k * MS), current_A(k * MS)) for k in range(beginning + 2 * PERIOD_MS)]
        self._forces = [force or 0.0 for force in forces[-PERIOD_MS:]]
        self.max_force_N = max(map(abs, self._forces))

    def force(self, stamp_ns: int) -> float:
        """Return the force at a stamp, between two milliseconds by interpolation."""
        position = stamp_ns % (PERIOD_MS * MS) / MS
        before = int(position)
        share = position - before
        return (1.0 - share) * self._forces[before] + share * self._forces[(before + 1) % PERIOD_MS]


JOINT = "rear_damper"
HEADER = b"\x00\x01\x00\x00"  # CDR, little-endian
ENCODINGS = (b"\x00\x00\x00\x00", b"\x00\x03\x00\x00", b"\x00\x07\x00\x00", b"\x00\x0b\x00\x00")  # others
STAMP_AT = len(HEADER)
SENTINEL = 1.2345678901234567
STAMP = struct.Struct("<iI")
DOUBLE = struct.Struct("<d")


class JointWire:
    """JointStates of fixed joints, in which only the stamp and the last joint's position change."""

    def __init__(self, names: Sequence[str]) -> None:
        message = JointState(name=list(names), position=[0.0] * (len(names) - 1) + [SENTINEL])
        message.header.frame_id = "chassis"
        self._bytes = bytearray(serialize_message(message))
        self._position_at = self._bytes.index(DOUBLE.pack(SENTINEL))

    def message(self, stamp_ns: int, position_m: float) -> bytes:
        """Return the bytes of one message."""
        STAMP.pack_into(self._bytes, STAMP_AT, *divmod(stamp_ns, 10**9))
        DOUBLE.pack_into(self._bytes, self._position_at, position_m)
        return bytes(self._bytes)


def read_estimate(message: bytes) -> tuple[int, float, float, float]:
    """Return stamp [ns], position, speed and force of one joint: the numbers end the message, each after its count."""
    seconds, nanoseconds = STAMP.unpack_from(message, STAMP_AT)
    position, speed, force = (DOUBLE.unpack_from(message, len(message) - back)[0] for back in (40, 24, 8))
    return seconds * 10**9 + nanoseconds, position, speed, force


def float64(value: float) -> bytes:
    """Return a std_msgs/Float64."""
    return HEADER + DOUBLE.pack(value)


def no_float64(dice: Random) -> bytes:
    """Return bytes too short for a Float64, in whole words as DDS sends them."""
    return HEADER + dice.randbytes(dice.randrange(5))


def no_joint_state(good: bytes, dice: Random) -> bytes:
    """Return bytes that are not a JointState: cut short, of random content, with absurd lengths or another encoding."""
    kind = dice.randrange(5)
    if kind == 0:
        return good[: dice.randrange(4, len(good) // 2)]
    if kind == 1:
        return HEADER + dice.randbytes(dice.randrange(300))
    if kind == 2:
        return good[:12] + b"\xff\xff\xff\x7f" + good[16:]
    if kind == 3:
        return dice.choice(ENCODINGS) + good[4:12] + dice.randbytes(len(good) - 12)
    return HEADER + b"\xff" * dice.randrange(64)


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
    """The messages of one tick; None: no current."""

    samples: list[PositionSample]
    current_A: float | None
    garbage_on: list[str] = field(default_factory=list)


Spoiler = Callable[[RideTick], None]
SpoilerMaker = Callable[[Random], Spoiler]


def stateless(change: Callable[..., None]) -> SpoilerMaker:
    """Make spoilers that change each tick alike, whatever came before."""
    return lambda dice: partial(change, dice=dice)


def duplicate(tick: RideTick, dice: Random) -> None:
    tick.samples *= dice.randint(1, 3)


def change_positions(value: Callable[[PositionSample, Random], float], share: float = 1.0) -> SpoilerMaker:
    """Make spoilers that replace a share of the positions by another value."""

    def change(tick: RideTick, dice: Random) -> None:
        tick.samples[:] = [
            replace(one, position_m=value(one, dice)) if dice.random() < share else one for one in tick.samples
        ]

    return stateless(change)


def set_current(value: float | None) -> SpoilerMaker:
    return stateless(lambda tick, dice: setattr(tick, "current_A", value))


def name_other_joint(tick: RideTick, dice: Random) -> None:
    tick.samples[:] = [replace(one, joint=OTHER_JOINT) for one in tick.samples]


def flood(tick: RideTick, dice: Random) -> None:
    """Publish true samples at ten times the rate."""
    stamps = [one.stamp_ns - k * MS // 10 for one in tick.samples for k in range(9, -1, -1)]
    tick.samples[:] = [PositionSample(stamp, stroke_m(stamp)) for stamp in stamps]


def dropouts(min_count: int, max_count: int) -> SpoilerMaker:
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


def freeze_position(dice: Random) -> Spoiler:
    frozen: list[float] = []

    def spoil(tick: RideTick) -> None:
        frozen.extend(one.position_m for one in tick.samples[: not frozen])
        tick.samples[:] = [replace(one, position_m=frozen[0]) for one in tick.samples]

    return spoil


def stamps_off(min_s: float, max_s: float, sign: int) -> SpoilerMaker:
    """Make spoilers that set the stamps off by a constant."""

    def make(dice: Random) -> Spoiler:
        off_ns = sign * MS * dice.randint(round(min_s * 1e3), round(max_s * 1e3))

        def spoil(tick: RideTick) -> None:
            tick.samples[:] = [replace(one, stamp_ns=one.stamp_ns + off_ns) for one in tick.samples]

        return spoil

    return make


def garbage(instead: bool, *topics: str) -> SpoilerMaker:
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


SPOILERS: dict[str, SpoilerMaker] = {
    "nothing": stateless(lambda tick, dice: None),
    "silence": stateless(lambda tick, dice: tick.samples.clear()),
    "short dropouts": dropouts(1, 5),
    "long dropouts": dropouts(20, 100),
    "duplicates": stateless(duplicate),
    "reordering": reordering,
    "nan": change_positions(lambda one, dice: nan),
    "some nan": change_positions(lambda one, dice: nan, 0.2),
    "inf": change_positions(lambda one, dice: dice.choice((inf, -inf))),
    "huge": change_positions(lambda one, dice: dice.choice((-1e300, 1e300))),
    "spikes": change_positions(_spike, 0.02),
    "stuck": freeze_position,
    "no current": set_current(None),
    "nan current": set_current(nan),
    "inf current": set_current(inf),
    "huge current": set_current(1e300),
    "ahead": stamps_off(2.0, 60.0, 1),
    "behind": stamps_off(2.0, 60.0, -1),
    "a little ahead": stamps_off(0.1, 0.4, 1),
    "a little behind": stamps_off(0.1, 0.4, -1),
    "wrong joint": stateless(name_other_joint),
    "flood": stateless(flood),
    "garbage among": garbage(False, POSITION, CURRENT),
    "garbage": garbage(True, POSITION, CURRENT),
}
