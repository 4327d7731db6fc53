"""The node's black box: its topics, and the folder of its bags. It starts with the first measured force."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from ces_observer.errors import CesError, RecordingError
from ces_observer.nodes.damper_topics import DamperTopics
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.input_subscriptions import InputSubscriptions
from ces_observer.nodes.message_definitions import bag_channel
from ces_observer.recorder.black_box import BlackBox
from ces_observer.recorder.mcap_file import require_mcap

TAIL = 1.0 / 3.0  # recorded time after the drift over that before it
WORK_S = 0.001  # for writing in each call of the watch timer


class BlackBoxRecording:
    """The black box of all dampers; `box` is None before the first measured force and if `record_dir` is empty."""

    def __init__(self, node: GuardedNode, inputs: InputSubscriptions, values: dict[str, Any]) -> None:
        self._node, self._inputs = node, inputs
        self._folder, self._seconds = values["record_dir"], values["record_s"]
        self._max_bags = values["record_max_bags"]
        self.box: BlackBox | None = None
        if self._folder:
            with suppress(RecordingError):  # `begin` reports it
                require_mcap()  # slow the first time, which would delay samples later

    def begin(self, dampers: Sequence[DamperTopics]) -> None:
        """Start keeping the last seconds of all inputs and of these dampers' estimates."""
        if self.box is not None or not self._folder:
            return
        topics = [*self._inputs.topics, *(damper.estimate_topic for damper in dampers)]
        try:
            require_mcap()
            channels = [bag_channel(topic, kind) for topic, kind in topics]
        except RecordingError as error:
            self._disable(str(error))
            return
        except (CesError, LookupError, OSError) as error:
            self._disable(f"no definition of a message type: {error}")
            return
        folder, tail_s = Path(self._folder).expanduser(), TAIL * self._seconds
        self.box = BlackBox(channels, folder, seconds=self._seconds, tail_s=tail_s, max_bags=self._max_bags)
        add = self._node.guard.wrap(self.box.add, partial(self._stop, dampers))
        self._inputs.on_message = add
        for channel, damper in enumerate(dampers, start=len(self._inputs.topics)):
            damper.on_estimate = partial(add, channel)

    def work(self, now_ns: int) -> None:
        """Continue writing for a short time."""
        if self.box is not None:
            self.box.work(WORK_S, now_ns)

    def _stop(self, dampers: Sequence[DamperTopics]) -> None:
        """Record no more after an unexpected error: the estimates need the node."""
        self.box = self._inputs.on_message = None
        for damper in dampers:
            damper.on_estimate = damper.health.box = None
        self._disable("unexpected error in the black box")

    def close(self) -> None:
        """Complete the bag that is being written."""
        if self.box is not None:
            self.box.close()

    def _disable(self, reason: str) -> None:
        self._node.get_logger().warning(f"drifts will not be recorded: {reason}")
        self._folder = ""
