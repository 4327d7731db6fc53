"""The node's black box: which topics it keeps and where its bags go; only if a measured force comes is it kept."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.node import Node

from ces_observer.errors import CesError, RecordingError
from ces_observer.nodes.damper_topics import DamperTopics
from ces_observer.nodes.input_subscriptions import InputSubscriptions
from ces_observer.nodes.message_definitions import bag_channel
from ces_observer.recorder.black_box import BlackBox
from ces_observer.recorder.mcap_file import require_mcap

TAIL = 1.0 / 3.0  # of the time before the drift that is recorded after it
WORK_S = 0.001  # what writing may take of each look of the watch


class BlackBoxRecording:
    """The black box of all dampers; `box` is None until the first measured force comes, or if there is to be none."""

    def __init__(self, node: Node, inputs: InputSubscriptions, values: dict[str, Any]) -> None:
        self._node, self._inputs = node, inputs
        self._folder, self._seconds = values["record_dir"], values["record_s"]
        self._most_bags = values["record_max_bags"]
        self.box: BlackBox | None = None
        if self._folder:
            with suppress(RecordingError):  # `begin` says so, if it comes to that
                require_mcap()  # takes a while the first time, which would hold up the samples later

    def begin(self, dampers: Sequence[DamperTopics]) -> None:
        """Keep the last seconds of all inputs, and of these dampers' estimates, from now on."""
        if self.box is not None or not self._folder:
            return
        topics = [*self._inputs.topics, *(damper.estimate_topic for damper in dampers)]
        try:
            require_mcap()
            channels = [bag_channel(topic, kind) for topic, kind in topics]
        except RecordingError as error:
            self._give_up(str(error))
            return
        except (CesError, LookupError, OSError) as error:
            self._give_up(f"no definition of a message type: {error}")
            return
        folder = Path(self._folder).expanduser()
        tail_s = TAIL * self._seconds
        self.box = BlackBox(channels, folder, seconds=self._seconds, tail_s=tail_s, max_bags=self._most_bags)
        self._inputs.on_message = self.box.add
        for channel, damper in enumerate(dampers, start=len(self._inputs.topics)):
            damper.kept = partial(self.box.add, channel)

    def work(self, now_ns: int) -> None:
        """Go on with what is being written, a little at a time."""
        if self.box is not None:
            self.box.work(WORK_S, now_ns)

    def close(self) -> None:
        """Complete what is being written."""
        if self.box is not None:
            self.box.close()

    def _give_up(self, reason: str) -> None:
        self._node.get_logger().warning(f"nothing will be recorded: {reason}")
        self._folder = ""
