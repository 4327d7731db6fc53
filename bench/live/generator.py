"""The load generator without rclcpp: like relay_cpp/generator.cpp, with the disturbance that Python adds.

Publishes joint_states and valve_current on a steady schedule, receives the estimates and prints one line of JSON.
"""

from __future__ import annotations

import json
import math
import os
import struct
import sys
import threading
import time
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

GRACE_NS = 500_000_000  # later estimates count as lost
DEFAULTS = {"rate_Hz": 1000.0, "warm_up_s": 2.0, "seconds": 5.0, "max_gap_s": 0.05, "after_gap_s": 0.6}
DEFAULTS |= {"pid": 0, "current_every": 1, "current_apart": False}
STAMP = struct.Struct("<iI")
ENCAPSULATION = 4  # bytes before the header's stamp, which is little-endian on all supported machines


class Generator:
    def __init__(self, node: Node) -> None:
        self.plan = {name: node.declare_parameter(name, default).value for name, default in DEFAULTS.items()}
        self.received: dict[int, int] = {}
        self._sample = JointState(name=["front_damper", "rear_damper"], position=[0.0, 0.0])
        self._sample.header.frame_id = "chassis"
        self._position = node.create_publisher(JointState, "joint_states", 100)
        self._current = node.create_publisher(Float64, "valve_current", 100)
        self._estimates = node.create_subscription(
            JointState, "estimate", self._on_estimate, QoSProfile(depth=1000), raw=True
        )
        self._node = node

    def is_matched(self) -> bool:
        return self._position.get_subscription_count() > 0 and self._node.count_publishers(self._estimates.topic) > 0

    def run(self) -> dict[str, float]:
        plan = self.plan
        warm, count = (round(plan[name] * plan["rate_Hz"]) for name in ("warm_up_s", "seconds"))
        stamps, late = [], []
        start, cpu, wall = time.monotonic() + 0.01, 0.0, 0.0
        for k in range(warm + count):
            due = start + k / plan["rate_Hz"]
            time.sleep(max(0.0, due - time.monotonic()))
            if k == warm:
                cpu, wall = cpu_s(plan["pid"]), time.monotonic()
            late.append(time.monotonic() - due)
            stamps.append(self._publish(k, due + 0.5 / plan["rate_Hz"]))
        share = (cpu_s(plan["pid"]) - cpu) / (time.monotonic() - wall)
        time.sleep(GRACE_NS * 1e-9)
        return self._summarize(stamps[warm:], late[warm:], share)

    def _publish(self, k: int, apart_at: float) -> int:
        stamp = time.time_ns()
        self._sample.position[1] = 0.02 * math.sin(4.0 * math.pi * 1e-9 * (stamp % 10**9))
        self._sample.header.stamp.sec, self._sample.header.stamp.nanosec = divmod(stamp, 10**9)
        self._position.publish(self._sample)
        if k % self.plan["current_every"] == 0:
            if self.plan["current_apart"]:
                time.sleep(max(0.0, apart_at - time.monotonic()))
            self._current.publish(Float64(data=0.5))
        return stamp

    def _on_estimate(self, message: bytes) -> None:
        seconds, nanoseconds = STAMP.unpack_from(message, ENCAPSULATION)
        self.received.setdefault(seconds * 10**9 + nanoseconds, time.time_ns())

    def _summarize(self, stamps: list[int], late: list[float], cpu_share: float) -> dict[str, float]:
        received = {s for s in stamps if self.received.get(s, math.inf) - s < GRACE_NS}
        if not received:
            sys.exit("generator: not one estimate was received")
        delays, late = sorted(self.received[s] - s for s in received), sorted(late)
        after_pause = len(self._after_pauses(stamps) - received)
        lost = len(stamps) - len(received) - after_pause
        results = {"sent": len(stamps), "lost": lost, "after_pause": after_pause, "cpu_share": cpu_share}
        results |= {f"p{share}_us": 1e-3 * delays[share * (len(delays) - 1) // 100] for share in (50, 99)}
        results |= {f"late_p{share}_us": 1e6 * late[share * (len(late) - 1) // 100] for share in (50, 99)}
        return results | {"max_us": 1e-3 * delays[-1]}

    def _after_pauses(self, stamps: list[int]) -> set[int]:
        """Return the stamps for which the observer may warm up because the generator itself had paused."""
        max_gap_ns, after_ns = (1e9 * self.plan[name] for name in ("max_gap_s", "after_gap_s"))
        resumed = [b for a, b in pairwise(stamps) if b - a > max_gap_ns]
        return {s for s in stamps if any(0 <= s - begin < after_ns for begin in resumed)}


def cpu_s(pid: int) -> float:
    """Return the CPU time [s], user and system, that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def spin_executor(executor: EventsExecutor) -> None:
    with suppress(ExternalShutdownException):
        executor.spin()


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("generator")
    generator = Generator(node)
    executor = EventsExecutor()
    executor.add_node(node)
    thread = threading.Thread(target=spin_executor, args=(executor,))
    thread.start()
    limit = time.monotonic() + 10.0
    while not generator.is_matched() and time.monotonic() < limit:
        time.sleep(0.01)
    try:
        print(json.dumps(generator.run()))
    finally:
        rclpy.shutdown()
        thread.join()


if __name__ == "__main__":
    main()
