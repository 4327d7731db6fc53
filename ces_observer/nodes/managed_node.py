"""A managed node: what it needs on ROS is made when it is configured, and published only while it is active.

The states are those of https://design.ros2.org/articles/node_lifecycle.html, and any lifecycle manager can drive them;
with the parameter `autostart` the node configures and activates itself.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from math import inf
from time import monotonic
from typing import Any, ClassVar

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleNodeMixin, TransitionCallbackReturn

from ces_observer.errors import CesError
from ces_observer.health.diagnostics import ACTIVE, INACTIVE, UNCONFIGURED
from ces_observer.limits import NodeLimits
from ces_observer.nodes.bond import Bond
from ces_observer.nodes.executors import START_ERRORS
from ces_observer.nodes.parameters import TableNode
from ces_observer.nodes.rclpy_gaps import freeze_objects, wrap_lifecycle_services


class ManagedNode(TableNode, LifecycleNodeMixin):  # type: ignore[misc]
    """A node with the steps `configure`, `activate` and `deactivate`; `made` undoes what `configure` has made so far.

    An exception of START_ERRORS in `configure` is a user's mistake: one line in the log, and the node is unconfigured.
    Any other exception is an error in the life cycle: the guard reports it, and the node lets go of everything.
    """

    IS_MANAGED: ClassVar[bool] = True

    def __init__(self, name: str) -> None:
        TableNode.__init__(self, name)
        self.is_active = False
        self.made = ExitStack()
        self.bond = Bond(self)
        self._mistake: Exception | None = None
        self._fell = self._is_starting = False
        self._next_start_s = inf
        # A request that cannot be read would block for good a group that runs one callback at a time.
        LifecycleNodeMixin.__init__(self, callback_group=ReentrantCallbackGroup())
        wrap_lifecycle_services(self, self.guard.wrap)

    def configure(self) -> None:
        """Read the parameters, and make what the node needs; may raise START_ERRORS."""
        raise NotImplementedError

    def activate(self) -> None:
        """Do what is to be done once before the node publishes."""

    def deactivate(self) -> None:
        """Publish what is to hold while the node is not active."""

    def destroy_node(self) -> None:
        """Let go of everything, then end the node."""
        self._run(self._let_go)
        super().destroy_node()

    @property
    def state(self) -> str:
        """State of its life cycle, such as `active`."""
        return str(self._state_machine.current_state[1])

    @property
    def is_configured(self) -> bool:
        """Whether it has read its parameters, and uses them."""
        return self.state in (INACTIVE, ACTIVE)

    @property
    def starts_itself(self) -> bool:
        """Whether the node configures and activates itself."""
        return bool(self.get_parameter("autostart").value)

    def start(self) -> None:
        """Configure and activate the node if it starts itself; raises one of START_ERRORS if it cannot."""
        if not self.starts_itself:
            return
        self._is_starting = True
        if self.state == UNCONFIGURED:
            self.trigger_configure()
        self._is_starting = False
        if self.state == INACTIVE:
            self.trigger_activate()
        if self.state != ACTIVE:
            raise self._mistake or CesError(f"the node cannot be started: {self.guard.last}")

    def fall(self, why: str) -> None:
        """Go through the error state to `unconfigured`; a node that starts itself does so again, after RETRY_S."""
        self.get_logger().error(f"{why}; the node lets go of everything and is unconfigured")
        self._fell = True
        self.trigger_deactivate()
        if self.starts_itself:
            self._next_start_s = monotonic() + NodeLimits.RETRY_S

    def start_again(self) -> None:
        """Start after a failure, if that is due."""
        if monotonic() < self._next_start_s:
            return
        self._next_start_s = monotonic() + NodeLimits.RETRY_S
        try:
            self.start()
            self._next_start_s = inf
        except START_ERRORS as error:
            self.get_logger().error(f"cannot be started again: {str(error).splitlines()[0]}")

    def on_configure(self, state: Any) -> Any:
        """Configure the node."""
        self._mistake = None
        try:
            self.configure()
        except START_ERRORS as error:
            self._mistake = error
            if not self._is_starting:
                self.get_logger().error(str(error).splitlines()[0])
            self._run(self._let_go)
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.guard.take(error)
            return TransitionCallbackReturn.ERROR
        freeze_objects()
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: Any) -> Any:
        """Let the node publish."""
        outcome = self._run(self.activate)
        self.is_active = outcome == TransitionCallbackReturn.SUCCESS
        if self.is_active and not self.starts_itself:
            self.guard.call(partial(self.bond.open, self.get_parameter("bond_heartbeat_period").value))
        return outcome

    def on_deactivate(self, state: Any) -> Any:
        """Let the node withhold; an error if it falls."""
        self.is_active = False
        self.guard.call(self.bond.close)
        outcome = self._run(self.deactivate)
        return TransitionCallbackReturn.ERROR if self._fell else outcome

    def on_cleanup(self, state: Any) -> Any:
        """Let go of everything."""
        self.is_active = False
        self.guard.call(self.bond.close)
        return self._run(self._let_go)

    def on_shutdown(self, state: Any) -> Any:
        """Let go of everything, as after a failure in any state."""
        if self.is_active:
            self.on_deactivate(state)
        return self.on_cleanup(state)

    def on_error(self, state: Any) -> Any:
        """Let go of everything, so that the node can be configured again."""
        self._fell = False
        self.on_cleanup(state)
        return TransitionCallbackReturn.SUCCESS

    def _let_go(self) -> None:
        made, self.made = self.made, ExitStack()
        made.close()

    def _run(self, step: Callable[[], None]) -> Any:
        try:
            step()
        except Exception as error:
            self.guard.take(error)
            return TransitionCallbackReturn.ERROR
        freeze_objects()
        return TransitionCallbackReturn.SUCCESS
