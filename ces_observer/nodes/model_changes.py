"""Changes the model of a running node: by its parameter `model` or its service `reload_model`.

The file is parsed at once; a parameter that names an invalid file is refused with the reason. The rest, such as
the proof of stability, may take longer than samples can wait, so a child process does it while the old model runs. If
it fails, the old model stays and the parameter is set back. The service answers at once what it has begun; a service
of rclpy cannot answer later without a coroutine, which some of its executors do not await. The outcome of each request
is latched on `~/model_status`, by its number. One model is checked at a time; of those that wait, only the newest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from time import monotonic
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from ces_observer.errors import CesError, ModelError
from ces_observer.limits import HealthLimits
from ces_observer.model import Model, load_model
from ces_observer.nodes.model_check import ModelReload, Verdict, model_facts
from ces_observer.nodes.outputs import LATCHED
from ces_observer.nodes.parameters import TableNode, model_path, value_of

WAITS, CHECKED, ACCEPTED, RUNS = "waits", "is being checked", "accepted", "has taken over"  # states of a request
REFUSED, OVERTAKEN = "refused", "overtaken"


@dataclass(frozen=True)
class ModelUser:
    """The user of a model, and its interfaces for changes.

    `running` returns the running model. `adopt` lets a checked one take over, now or later, and returns in words when.
    `parameter` returns the name of the parameter that holds the file's path.
    """

    running: Callable[[], Model]
    adopt: Callable[[Verdict], str]
    parameter: Callable[[], str]
    prefix: str  # of the names of service and status
    tasks: tuple[str, ...]  # of model_check, before a model is adopted
    require: Callable[[Model], object] = lambda model: None  # raises CesError for a model that this user cannot run
    prepare: Callable[[Model], object] = lambda model: None  # runs in a thread beside the check: samples go on


class ModelRequest(NamedTuple):
    """A request for another model: its number, the model, its file, and the parameter's text."""

    number: int
    model: Model | None
    source: str
    text: str


class ModelChanges:
    """The changes of one user's model: `source` of the running one, `state` of the last, number of those `refused`."""

    def __init__(self, node: TableNode, user: ModelUser, path: Path) -> None:
        self.source = str(path)
        self.state = "none"
        self.refused = 0
        self._node, self._user = node, user
        self._running = user.running()
        self._reload = ModelReload()
        self._requests = 0
        self._waiting: ModelRequest | None = None
        self._checking: ModelRequest | None = None
        self._accepted: ModelRequest | None = None
        self._prepares = Thread()
        self._good_path, self._logged_s = self._read_parameter(), float("-inf")
        self._status = node.create_publisher(DiagnosticStatus, f"{user.prefix}model_status", LATCHED)
        self._service = node.create_service(Trigger, f"{user.prefix}reload_model", self._on_service)

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the key-value pairs for diagnostics."""
        return ("last change of the model", self.state), ("models refused", str(self.refused))

    def begin_from_parameter(self) -> None:
        """Start a change to the file that the parameter names, if that is another; it is answered as the service is."""
        text = self._read_parameter()
        if text != self._good_path:
            begun, said = self._answer(text)
            self._node.answer = SetParametersResult(successful=begun, reason=said)
            return
        waiting, checking = self._waiting, self._checking  # requests by the parameter, which was set back, are void
        if waiting is not None and waiting.text != text:
            self._waiting = None
            self._report(waiting, OVERTAKEN, "the parameter was set back")
        if checking is not None and checking.text != text:
            self._checking = None
            self._reload.cancel()
            self._report(checking, OVERTAKEN, "the parameter was set back")

    def poll(self) -> bool:
        """Start or finish a check; return whether another model has taken over since the last call."""
        verdict = None if self._prepares.is_alive() else self._reload.poll()
        if verdict is not None:
            self._finish(verdict)
        if self._checking is None and self._waiting is not None:
            self._check_next()
        if self._user.running() is self._running:
            return False
        self._running = self._user.running()
        accepted, self._accepted = self._accepted, None
        if accepted is not None:
            self.source = accepted.source
            self._report(accepted, RUNS)
        return True

    def close(self) -> None:
        """Cancel a change in progress, and withdraw service and topic."""
        self._waiting = self._checking = None
        self._reload.cancel()
        self._node.destroy_service(self._service)
        self._node.destroy_publisher(self._status)

    def _read_parameter(self) -> str:
        return str(value_of(self._node, self._user.parameter()))

    def _next_request(self, model: Model | None, source: str, text: str) -> ModelRequest:
        self._requests += 1
        return ModelRequest(self._requests, model, source, text)

    def _begin_file(self, text: str) -> ModelRequest | str:
        """Let the file in the parameter be checked; return the request, or why it is refused."""
        try:
            path = model_path(text)
            return self._begin(self._next_request(load_model(path), str(path), text))
        except (CesError, OSError) as error:
            self._refuse(self._next_request(None, text, text), str(error))
            return str(error)

    def _begin(self, request: ModelRequest) -> ModelRequest:
        """Let the model of a request wait for its check; raises CesError if its user cannot run it."""
        if request.model is not None:
            self._user.require(request.model)
        overtaken, self._waiting = self._waiting, request
        if overtaken is not None:
            self._report(overtaken, OVERTAKEN, f"by {request.source}")
            if overtaken.text != request.text:
                self._restore_parameter(overtaken)
        behind = "" if self._checking is None else f"for the check of {self._checking.source}"
        self._report(request, WAITS if behind else CHECKED, behind)
        return request

    def _check_next(self) -> None:
        request, self._waiting = self._waiting, None
        if request is None or request.model is None:
            return
        try:
            self._reload.start(request.model, request.source, self._user.tasks)
        except OSError as error:
            self._refuse(request, f"{request.source}: no process can be started to check it: {error.strerror}")
            return
        self._prepares = Thread(target=self._user.prepare, args=(request.model,), daemon=True)
        self._prepares.start()
        self._checking = request
        self._report(request, CHECKED)

    def _finish(self, verdict: Verdict) -> None:
        """Adopt or refuse the model whose check has ended."""
        request, self._checking = self._checking, None
        if request is None:
            return
        try:
            if verdict.error:
                raise ModelError(verdict.error)
            when = self._user.adopt(verdict)
        except CesError as error:
            self._refuse(request, str(error))
        except Exception as error:
            self._node.guard.take(error)
            self._refuse(request, f"{request.source}: unexpected {type(error).__name__}: {error}")
        else:
            if self._accepted is not None:
                self._report(self._accepted, OVERTAKEN, f"by {request.source}")
            self._accepted, self._good_path = request, request.text
            self._report(request, ACCEPTED, f"takes over {when}")
            self._node.get_logger().info(self.state)

    def _refuse(self, request: ModelRequest, reason: str) -> None:
        self.refused += 1
        self._report(request, REFUSED, reason)
        if monotonic() - self._logged_s >= HealthLimits.QUIET_S:
            self._logged_s = monotonic()
            self._node.get_logger().error(self.state)
        self._restore_parameter(request)

    def _restore_parameter(self, request: ModelRequest) -> None:
        """Set the parameter back to the running model, if it names the file of this request, which will not run."""
        if request.text != self._good_path and request.text == self._read_parameter():
            self._node.set_parameters([Parameter(self._user.parameter(), value=self._good_path)])

    def _on_service(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Read the file in the parameter again; answer whether it is valid, and so will be checked."""
        response.success, response.message = self._answer(self._read_parameter())
        return response

    def _answer(self, text: str) -> tuple[bool, str]:
        """Let the file in the parameter be checked; return whether that has begun, and what is to be said."""
        begun = self._begin_file(text)
        if isinstance(begun, str):
            return False, _clean(begun)
        said = f"request {begun.number}: {self.state}; the outcome comes on {self._status.topic_name}"
        return True, _clean(said)

    def _report(self, request: ModelRequest, state: str, detail: str = "") -> None:
        """Keep the state of a request for diagnostics, and latch it."""
        if state == REFUSED:
            self.state = f"refused, the old model runs on: {detail}"
        else:
            self.state = f"{request.source}: {state}" + (f"; {detail}" if detail else "")
        values = {"request": str(request.number), "state": state, "model": request.source}
        if request.model is not None:
            values |= model_facts(request.model)
        level = DiagnosticStatus.ERROR if state == REFUSED else DiagnosticStatus.OK
        pairs = [KeyValue(key=key, value=_clean(value)) for key, value in values.items()]
        name = f"{self._node.get_fully_qualified_name()}: request {request.number}"
        status = DiagnosticStatus(level=level, name=name, message=_clean(self.state), values=pairs)
        self._node.guard.call(lambda: self._status.publish(status))


def _clean(text: str) -> str:
    """Return the text as a message can carry it: a file's name may have bytes that are no UTF-8."""
    return text.encode("utf-8", "replace").decode()
