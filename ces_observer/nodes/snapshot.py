"""Asks a running `ros2 bag record --snapshot-mode` to write its last seconds: when a model has drifted, or on request.

The recorder's service is called by a child process, snapshot_call: neither the wait for the recorder nor its answer can
disturb the node.
"""

from __future__ import annotations

import subprocess
from time import monotonic
from typing import Any

from rclpy.service import Service

from ces_observer.limits import NodeLimits
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.model_check import start_child

RESULTS: dict[int | None, str] = {  # by the exit status of the child, None while it runs
    0: "taken: the recorder has written its last seconds",
    None: f"not taken: no answer within {NodeLimits.MAX_SNAPSHOT_S:g} s",
    3: "not taken: rosbag2_interfaces is not installed",
    4: "not taken: no recorder in snapshot mode; start 'ros2 bag record --snapshot-mode' for the topics to keep",
    5: "not taken: the recorder refused",
}


class Snapshots:
    """Calls the service `name` of a recorder; without a name it does nothing. `state` says how the last call went."""

    def __init__(self, node: GuardedNode, name: str, after_s: float) -> None:
        self._node, self._name, self._after_s = node, name, after_s
        self._due_s: float | None = None
        self._asked_s = -NodeLimits.SNAPSHOT_PAUSE_S
        self._child: subprocess.Popen[bytes] | None = None
        self._service: Service | None = None
        self.state = "none taken" if name else "off"
        if name:
            from std_srvs.srv import Trigger

            self._service = node.create_service(Trigger, "~/snapshot", self._on_request)

    def note_drift(self, drift: str) -> bool:
        """Plan a snapshot that has the seconds after a drift in it, too; return whether there will be one."""
        now = monotonic()
        if not self._name or self._due_s is not None or now - self._asked_s < NodeLimits.SNAPSHOT_PAUSE_S:
            return False
        self._node.get_logger().warning(f"{drift}; a snapshot is taken in {self._after_s:g} s")
        self._due_s, self.state = now + self._after_s, f"due within {self._after_s:g} s"
        return True

    def work(self) -> None:
        """Take a snapshot that is due, and look after one that is being taken; never waits."""
        now = monotonic()
        if self._child is not None:
            status = self._child.poll()
            if status is None and now - self._asked_s < NodeLimits.MAX_SNAPSHOT_S:
                return
            self._end_call()
            self.state = RESULTS.get(status, f"not taken: the call ended with status {status}")
            self._node.get_logger().info(f"snapshot {self.state}")
        elif self._due_s is not None and now >= self._due_s:
            self._take(now)

    def close(self) -> None:
        """End a call in progress, and withdraw the service."""
        self._end_call()
        if self._service is not None:
            self._node.destroy_service(self._service)

    def _end_call(self) -> None:
        if self._child is not None:
            self._child.kill()
            self._child.wait()
            self._child = None

    def _on_request(self, request: Any, response: Any) -> Any:
        """Take a snapshot now; the diagnostics say how it went."""
        if self._child is None:
            self._take(monotonic())
        response.success, response.message = True, f"{self._name} is being asked; the diagnostics have its answer"
        return response

    def _take(self, now_s: float) -> None:
        self._due_s, self._asked_s, self.state = None, now_s, "being taken"
        try:
            self._child = start_child(("-m", "ces_observer.nodes.snapshot_call", self._name))
        except OSError as error:
            self.state = f"not taken: no process for it: {error.strerror or error}"
