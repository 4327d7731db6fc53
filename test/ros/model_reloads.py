"""Calls of a node's service `reload_model`, and the outcome of each, which the node latches on `model_status`."""

from __future__ import annotations

import time
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus
from patience import PATIENCE_S, wait_until
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

ENDS = ("accepted", "refused", "overtaken")  # the last state before which another model may run
EVERY = QoSProfile(depth=1000, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a request: whether the model was accepted, and the line that says so or why not."""

    success: bool
    message: str


class ModelReloads:
    """The service and the status of the node `name`, relative to the namespace of `node`."""

    def __init__(self, node: Node, name: str) -> None:
        self.statuses: list[DiagnosticStatus] = []
        self._client = node.create_client(Trigger, f"{name}/reload_model", qos_profile=QoSProfile(depth=1000))
        node.create_subscription(DiagnosticStatus, f"{name}/model_status", self.statuses.append, EVERY)

    def call(self, timeout_s: float = PATIENCE_S) -> Outcome:
        """Have the file read again; return the outcome, which is the answer itself for a file that is no model."""
        answer, end = self.answer(), time.monotonic() + timeout_s
        while (outcome := self._find_outcome(answer)) is None:
            assert time.monotonic() < end, "no outcome of reload_model in time"
            time.sleep(0.005)
        return outcome

    def answer(self) -> Trigger.Response:
        """Have the file read again; return the answer of the service."""
        return self.answers(1)[0]

    def answers(self, count: int) -> list[Trigger.Response]:
        """Make so many requests at once; return the answers."""
        assert self._client.wait_for_service(PATIENCE_S)
        futures = [self._client.call_async(Trigger.Request()) for _ in range(count)]
        wait_until(lambda: all(one.done() for one in futures), "no answer of reload_model in time")
        return [one.result() for one in futures]

    def _find_outcome(self, answer: Trigger.Response) -> Outcome | None:
        if not answer.success:
            return Outcome(False, answer.message)
        number = answer.message.partition(":")[0].removeprefix("request ")
        for status in list(self.statuses):
            values = {pair.key: pair.value for pair in status.values}
            if values["request"] == number and values["state"] in ENDS:
                return Outcome(values["state"] == "accepted", status.message)
        return None
