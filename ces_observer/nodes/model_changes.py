"""Changes the model of a running node: by its parameter `model`, its service `reload_model`, or a latched topic.

The file or text is parsed at once; a parameter that names an invalid file is refused with the reason. The rest, such as
the proof of stability, may take longer than samples can wait, so a child process does it while the old model runs. If
it fails, the old model stays and the parameter is set back. The service answers at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ces_observer.errors import CesError
from ces_observer.model import Model, load_model, parse_model
from ces_observer.nodes.model_reload import ModelReload, Verdict
from ces_observer.nodes.node_parameters import model_path, value_of
from ces_observer.nodes.qos import LATCHED


@dataclass(frozen=True)
class ModelUser:
    """The user of a model, and its interfaces for changes.

    `running` returns the running model. `adopt` lets a checked one take over, now or later, and returns in words when.
    `parameter` returns the name of the parameter that holds the file's path.
    """

    running: Callable[[], Model]
    adopt: Callable[[Verdict], str]
    parameter: Callable[[], str]
    prefix: str  # of the service's name
    topic: str  # latched, with models as text; empty: none
    tasks: tuple[str, ...]  # of model_check, before a model is adopted
    require: Callable[[Model], None] = lambda model: None  # raises CesError for a model that this user cannot run


class ModelChanges:
    """The changes of one user's model.

    `source` is the origin of the running model, `state` a line on the last change, `refused` the number of refusals.
    """

    def __init__(self, node: Node, user: ModelUser, path: Path) -> None:
        self.source = str(path)
        self.state = "none"
        self.refused = 0
        self._node, self._user = node, user
        self._running, self._next_source = user.running(), ""
        self._reload = ModelReload()
        self._waiting: list[Future] = []
        self._good_path, self._to_set_back = self._read_parameter(), False
        node.create_service(Trigger, f"{user.prefix}reload_model", self._on_service)
        if user.topic:
            options = QoSOverridingOptions.with_default_policies()
            node.create_subscription(String, user.topic, self._on_topic, LATCHED, qos_overriding_options=options)

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the key-value pairs for diagnostics."""
        return ("last change of the model", self.state), ("models refused", str(self.refused))

    def begin_from_parameter(self) -> None:
        """Start a change to the file that the parameter names, if that is another."""
        text = self._read_parameter()
        if text == self._good_path:
            self._cancel_parameter_change()
            return
        self._to_set_back = True
        try:
            self._begin_file(text)
        except (CesError, OSError) as error:
            self._refuse(str(error))

    def poll(self) -> bool:
        """Handle a finished check; return whether another model has taken over since the last call."""
        verdict = self._reload.poll()
        if verdict is not None and verdict.error:
            self._refuse(verdict.error)
        elif verdict is not None:
            self._adopt(verdict)
        if self._user.running() is self._running:
            return False
        self._running, self.source = self._user.running(), self._next_source
        self.state = f"{self.source}: has taken over"
        return True

    def close(self) -> None:
        """Cancel a change in progress."""
        self._reload.cancel()

    def _read_parameter(self) -> str:
        """Return the present path in the parameter."""
        return str(value_of(self._node, self._user.parameter()))

    def _begin_file(self, text: str) -> None:
        path = model_path(text)
        self._begin(load_model(path), str(path))

    def _begin(self, model: Model, source: str) -> None:
        self._user.require(model)
        self._answer(False, f"overtaken by {source}")
        self._reload.start(model, source, self._user.tasks)
        self.state = f"{source}: is being checked"

    def _adopt(self, verdict: Verdict) -> None:
        when = self._user.adopt(verdict)
        self._next_source = verdict.source
        self._good_path, self._to_set_back = self._read_parameter(), False
        self.state = f"{verdict.source}: accepted; takes over {when}"
        self._node.get_logger().info(self.state)
        self._answer(True, self.state)

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self.state = f"refused, the old model runs on: {reason}"
        self._node.get_logger().error(self.state)
        self._answer(False, reason)
        self._restore_parameter()

    def _restore_parameter(self) -> None:
        """Set the parameter back to the running model, if it names one that was not accepted."""
        if self._to_set_back:
            self._to_set_back = False
            self._node.set_parameters([Parameter(self._user.parameter(), value=self._good_path)])

    def _cancel_parameter_change(self) -> None:
        """Cancel a change that the parameter requested, because it was set back."""
        if self._to_set_back:
            self._to_set_back, self.state = False, "none"
            self._reload.cancel()

    async def _on_service(self, request: Any, response: Any) -> Any:
        """Answer when the model in the parameter's file is accepted or refused."""
        try:
            self._begin_file(self._read_parameter())
        except (CesError, OSError) as error:
            self._refuse(str(error))
            response.success, response.message = False, str(error)
            return response
        done = Future()
        self._waiting.append(done)
        response.success, response.message = await done
        return response

    def _on_topic(self, message: String) -> None:
        source = f"topic {self._user.topic}"
        try:
            model = parse_model(message.data, source)
            self._restore_parameter()
            self._begin(model, source)
        except (CesError, OSError) as error:
            self._refuse(str(error))

    def _answer(self, success: bool, message: str) -> None:
        """Answer the pending service calls."""
        waiting, self._waiting = self._waiting, []
        for done in waiting:
            done.set_result((success, message))
