"""Asks a running `ros2 bag record --snapshot-mode` to write its last seconds when a model has drifted.

It never waits: the node looks now and then whether the recorder is there, and whether it has answered.
"""

from __future__ import annotations

from time import monotonic
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

from ces_observer.limits import NodeLimits
from ces_observer.nodes.guarded_node import GuardedNode

TAKEN, REFUSED = "taken: the recorder has written its last seconds", "not taken: the recorder refused"
NO_ANSWER = f"not taken: no answer within {NodeLimits.MAX_SNAPSHOT_S:g} s"
NO_RECORDER = "not taken: no recorder in snapshot mode; start 'ros2 bag record --snapshot-mode' for the topics to keep"
FIND_S = 5.0  # for the recorder to be found


class Snapshots:
    """Calls the service `name` of a recorder; without a name it does nothing. `state` says how the last call went."""

    def __init__(self, node: GuardedNode, name: str, after_s: float) -> None:
        self._node, self._name, self._after_s = node, name, after_s
        self._due_s: float | None = None
        self._asked_s = -NodeLimits.SNAPSHOT_PAUSE_S
        self._client: Any = None  # of a call in progress
        self._answer: Any = None
        self.state = "none taken" if name else "off"

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
        if self._client is not None:
            self._look_after(now - self._asked_s)
        elif self._due_s is not None and now >= self._due_s:
            self._take(now)

    def close(self) -> None:
        """End a call in progress."""
        self._end_call(self.state)

    def _look_after(self, waited_s: float) -> None:
        """Send the request when the recorder is there, and end the call when it is over."""
        if self._answer is None and self._client.service_is_ready():
            self._answer = self._client.call_async(self._client.srv_type.Request())
        if self._answer is not None and self._answer.done():
            self._end_call(TAKEN if self._answer.result().success else REFUSED)
        elif self._answer is None and waited_s > FIND_S:
            self._end_call(NO_RECORDER)
        elif waited_s > NodeLimits.MAX_SNAPSHOT_S:
            self._end_call(NO_ANSWER)

    def _end_call(self, state: str) -> None:
        if self._client is not None:
            self._node.destroy_client(self._client)
            self._node.get_logger().info(f"snapshot {state}")
        self._client, self._answer, self.state = None, None, state

    def _take(self, now_s: float) -> None:
        self._due_s, self._asked_s, self.state = None, now_s, "being taken"
        group = MutuallyExclusiveCallbackGroup()  # an answer that cannot be read would block any other
        try:
            from rosbag2_interfaces.srv import Snapshot

            self._client = self._node.create_client(Snapshot, self._name, callback_group=group)
        except (ImportError, RuntimeError) as error:  # not installed, not permitted
            self.state = f"not taken: {error}"
