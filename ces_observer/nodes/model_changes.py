"""How a running damper gets another model: by its parameter `model`, its service `reload_model`, or a latched topic.

The file or text is read and its structure checked at once: a parameter that names a wrong one is refused with the
reason. The proof of stability may take longer than samples can wait, so a child process makes it. Until it has, the old
model runs; if it fails, the old model runs on and the parameter goes back to it. The service answers when it is done.
"""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ces_observer.damper_observer import DamperObserver
from ces_observer.errors import CesError
from ces_observer.model import Model, load_model, parse_model
from ces_observer.nodes.model_reload import ModelReload, Verdict
from ces_observer.nodes.observer_parameters import Settings, governing, live_value, model_path

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


class ModelChanges:
    """The models on their way to one damper.

    `source` is where the model that runs comes from; `state` a line on the last change, `refused` how many were none.
    """

    def __init__(self, node: Node, settings: Settings, damper: DamperObserver) -> None:
        self.source = str(settings.model_path)
        self.state = "none"
        self.refused = 0
        self._node, self._settings, self._damper = node, settings, damper
        self._running, self._next_source = damper.model, ""
        self._reload = ModelReload()
        self._waiting: list[Future] = []
        self._good_path, self._to_set_back = live_value(node, settings, "model"), False
        node.create_service(Trigger, f"{settings.topics}reload_model", self._on_service)
        if topic := settings.values["model_topic"]:
            options = QoSOverridingOptions.with_default_policies()
            node.create_subscription(String, topic, self._on_topic, LATCHED, qos_overriding_options=options)

    def parameter_set(self) -> None:
        """Begin to change to the model that the parameter names, if it names another."""
        text = live_value(self._node, self._settings, "model")
        if text == self._good_path:
            self._forget_parameter()
            return
        self._to_set_back = True
        try:
            self._begin_file(text)
        except (CesError, OSError) as error:
            self._refuse(str(error))

    def poll(self) -> bool:
        """Act upon a check that is done; returns whether another model has taken over since the last call."""
        verdict = self._reload.poll()
        if verdict is not None and verdict.error:
            self._refuse(verdict.error)
        elif verdict is not None:
            self._adopt(verdict)
        if self._damper.model is self._running:
            return False
        self._running, self.source = self._damper.model, self._next_source
        self.state = f"{self.source}: has taken over"
        return True

    def close(self) -> None:
        """Give up what is under way."""
        self._reload.cancel()

    def _begin_file(self, text: str) -> None:
        path = model_path(text)
        self._begin(load_model(path), str(path))

    def _begin(self, model: Model, source: str) -> None:
        self._answer(False, f"overtaken by {source}")
        self._reload.start(model, source, prove=not self._settings.values["allow_uncertified"])
        self.state = f"{source}: its stability is being proved"

    def _adopt(self, verdict: Verdict) -> None:
        self._damper.load(verdict.model)
        self._next_source = verdict.source
        self._good_path, self._to_set_back = live_value(self._node, self._settings, "model"), False
        warm_up_s = verdict.model.sampling.warm_up_s
        self.state = f"{verdict.source}: accepted; takes over when warmed up, after {warm_up_s:g} s of samples"
        self._node.get_logger().info(self.state)
        self._answer(True, self.state)

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self.state = f"refused, the model before runs on: {reason}"
        self._node.get_logger().error(self.state)
        self._answer(False, reason)
        self._set_back()

    def _set_back(self) -> None:
        """Let the parameter name the model that runs, if it names one that was not accepted."""
        if self._to_set_back:
            self._to_set_back = False
            name = governing(self._node, self._settings, "model")
            self._node.set_parameters([Parameter(name, value=self._good_path)])

    def _forget_parameter(self) -> None:
        """Give up a change that was asked for by the parameter, as it was set back meanwhile."""
        if self._to_set_back:
            self._to_set_back, self.state = False, "none"
            self._reload.cancel()

    async def _on_service(self, request: Any, response: Any) -> Any:
        """Answer when the model in the parameter's file is accepted or refused."""
        del request
        try:
            self._begin_file(live_value(self._node, self._settings, "model"))
        except (CesError, OSError) as error:
            self._refuse(str(error))
            response.success, response.message = False, str(error)
            return response
        done = Future()
        self._waiting.append(done)
        response.success, response.message = await done
        return response

    def _on_topic(self, message: String) -> None:
        source = f"topic {self._settings.values['model_topic']}"
        try:
            model = parse_model(message.data, source)
            self._set_back()
            self._begin(model, source)
        except (CesError, OSError) as error:
            self._refuse(str(error))

    def _answer(self, success: bool, message: str) -> None:
        """Answer whoever waits at the service."""
        waiting, self._waiting = self._waiting, []
        for done in waiting:
            done.set_result((success, message))
