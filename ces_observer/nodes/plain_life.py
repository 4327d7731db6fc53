"""Stands in for rclpy's life cycle of nodes where that is not installed: the same steps, but nobody else takes them."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from types import SimpleNamespace
from typing import Any


class TransitionCallbackReturn(Enum):
    """What a transition came to."""

    SUCCESS, FAILURE, ERROR = "success", "failure", "error"


class LifecycleNodeMixin:
    """The part of rclpy's class of this name that `ManagedNode` uses."""

    is_plain = True
    on_configure: Callable[[Any], TransitionCallbackReturn]
    on_activate: Callable[[Any], TransitionCallbackReturn]
    on_deactivate: Callable[[Any], TransitionCallbackReturn]
    on_error: Callable[[Any], TransitionCallbackReturn]

    def __init__(self, **_: Any) -> None:
        self._state_machine = SimpleNamespace(current_state=(0, "unconfigured"))

    def trigger_configure(self) -> None:
        """Configure."""
        self._go(self.on_configure, "inactive")

    def trigger_activate(self) -> None:
        """Activate."""
        self._go(self.on_activate, "active")

    def trigger_deactivate(self) -> None:
        """Deactivate."""
        self._go(self.on_deactivate, "inactive")

    def _go(self, step: Callable[[Any], TransitionCallbackReturn], state: str) -> None:
        outcome = step(None)
        if outcome is TransitionCallbackReturn.ERROR:
            self.on_error(None)
        if outcome is not TransitionCallbackReturn.FAILURE:
            state = state if outcome is TransitionCallbackReturn.SUCCESS else "unconfigured"
            self._state_machine.current_state = (0, state)
