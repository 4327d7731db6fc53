"""The source of the ride, a separate process: position and current at 1 kHz, corrupted on command.

Reads commands from standard input, one JSON object per line: {"id": 1, "spoiler": "nan", "seconds": 0.5, "seed": 7}.
Writes events to standard output as JSON lines: running, and begin and end of each episode. `first_ns` and `last_ns` are
the stamps published during the episode, `good_ns` is the stamp of the first good sample after it; times are wall time.
Samples that are due while the process is stopped are published in a burst when it continues; it has then "caught up".
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import deque
from random import Random
from typing import Any

import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from bench.reliability.ride import (
    CURRENT,
    JOINT,
    MS,
    OTHER_JOINT,
    POSITION,
    RATE_HZ,
    SPOILERS,
    JointWire,
    PositionSample,
    RideTick,
    current_A,
    float64,
    no_float64,
    no_joint_state,
    stroke_m,
)

DEPTH = 100
CURRENT_EVERY = 2
OVERDUE_S = 0.1


class RideSource:
    """Publishers of the ride."""

    def __init__(self) -> None:
        self._node = rclpy.create_node("source")
        self._position = self._node.create_publisher(JointState, POSITION, DEPTH)
        self._current = self._node.create_publisher(Float64, CURRENT, DEPTH)
        self._wires = {joint: JointWire(["steering", joint]) for joint in (JOINT, OTHER_JOINT)}
        self._commands: deque[dict[str, Any]] = deque()
        self._episode: SpoilerEpisode | None = None
        self._over = threading.Event()
        self._overdue = False
        self._dice = Random(0)

    def run(self) -> None:
        """Publish until standard input is closed."""
        while self._position.get_subscription_count() == 0:
            time.sleep(0.005)
        threading.Thread(target=self._listen, daemon=True).start()
        self._begin_ns = time.time_ns() // MS * MS
        self._begin_s, k = time.monotonic(), 0
        print_event(event="running", good_ns=self._begin_ns, at_ns=time.time_ns())
        while not self._over.is_set():
            k += 1
            self._wait(k)
            self._tick(k)

    def _wait(self, k: int) -> None:
        """Wait until a tick is due; report the end of a row of overdue ticks."""
        early_s = self._begin_s + k / RATE_HZ - time.monotonic()
        self._overdue |= early_s < -OVERDUE_S
        if early_s > 0.0:
            time.sleep(early_s)
            if self._overdue:
                self._overdue = False
                print_event(event="caught up", good_ns=self._begin_ns + k * MS, at_ns=time.time_ns())

    def _tick(self, k: int) -> None:
        stamp = self._begin_ns + k * MS
        if self._episode is None and self._commands:
            self._episode = SpoilerEpisode(k, **self._commands.popleft())
        tick = RideTick([PositionSample(stamp, stroke_m(stamp))], current_A(stamp))
        if self._episode is not None and not self._episode.spoil(k, tick):
            self._episode.report_end(stamp)
            self._episode = None
        self._send(k, tick)

    def _send(self, k: int, tick: RideTick) -> None:
        if k % CURRENT_EVERY == 0 and tick.current_A is not None:
            self._current.publish(float64(tick.current_A))
        for one in tick.samples:
            self._position.publish(self._wires[one.joint].message(one.stamp_ns, one.position_m))
        for topic in tick.garbage_on:
            if topic == POSITION:
                self._position.publish(no_joint_state(self._wires[JOINT].message(0, 0.0), self._dice))
            else:
                self._current.publish(no_float64(self._dice))

    def _listen(self) -> None:
        for line in sys.stdin:
            self._commands.append(json.loads(line))
        self._over.set()


class SpoilerEpisode:
    """A spoiler that is active from tick `k` on."""

    def __init__(self, k: int, id: int, spoiler: str, seconds: float, seed: int) -> None:
        self._id, self._end = id, k + round(seconds * RATE_HZ)
        self._spoil = SPOILERS[spoiler](Random(seed))
        self._stamps: list[int] = []
        print_event(event="began", id=id, at_ns=time.time_ns())

    def spoil(self, k: int, tick: RideTick) -> bool:
        """Corrupt the tick; return False without changing it when the episode is over."""
        if k >= self._end:
            return False
        self._spoil(tick)
        stamps = [one.stamp_ns for one in tick.samples]
        self._stamps[:] = [min(self._stamps[:1] + stamps), max(self._stamps[1:] + stamps)] if stamps else self._stamps
        return True

    def report_end(self, good_ns: int) -> None:
        first, last = self._stamps or (0, 0)
        print_event(event="ended", id=self._id, at_ns=time.time_ns(), good_ns=good_ns, first_ns=first, last_ns=last)


def print_event(**facts: object) -> None:
    print(json.dumps(facts), flush=True)


def main() -> None:
    rclpy.init()
    RideSource().run()


if __name__ == "__main__":
    main()
