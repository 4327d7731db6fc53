"""The model whose inverse map the controller uses, and its replacement while the loop runs."""

from __future__ import annotations

from ces_observer.control.force_controller import ForceController
from ces_observer.control.model_inverse import ModelInverse
from ces_observer.nodes.controller_parameters import ControllerSettings, read_live_settings
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.model_changes import ModelChanges, ModelUser
from ces_observer.nodes.model_check import INVERT, PROVE
from ces_observer.nodes.model_reload import Verdict


class ControllerModel:
    """The model of a running `controller`; `lag_s` [s] is the lag of its force behind the current.

    `changes` handles the models that shall replace it.
    """

    def __init__(self, node: GuardedNode, settings: ControllerSettings, controller: ForceController) -> None:
        self.lag_s = settings.inverse.lag_s
        self._node, self._controller, self._model = node, controller, settings.model
        user = ModelUser(
            running=lambda: self._model,
            adopt=self._adopt,
            parameter=lambda: "model",
            prefix="~/",
            topic=settings.values["model_topic"],
            tasks=(INVERT,) if settings.values["allow_uncertified"] else (PROVE, INVERT),
        )
        self.changes = ModelChanges(node, user, settings.model_path)

    def facts(self) -> dict[str, str]:
        """Return the model's key-value pairs for diagnostics."""
        return {
            "model": self.changes.source,
            "model sha256": self._model.digest(),
            "lag of the model's force behind the current [ms]": f"{self.lag_s * 1e3:.1f}",
        }

    def _adopt(self, verdict: Verdict) -> str:
        """Change to a checked model and its inverse."""
        inverse = ModelInverse.from_json(verdict.inverse)
        tuning = read_live_settings(self._node, (), inverse.lag_s).tuning
        self._model, self.lag_s = verdict.model, inverse.lag_s
        self._controller.tuning = tuning
        self._controller.adopt(inverse.map)
        return f"within {tuning.recovery_s:g} s"
