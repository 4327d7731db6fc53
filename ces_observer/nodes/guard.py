"""The guard of a node's callbacks: an unexpected exception is counted and reported, and never leaves the callback.

A failure of each kind (type and place) is logged once, with its traceback; diagnostics show how many there were and the
last. What the failed callback may have left half done is put right by its `on_failure`. This module does not use ROS.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from inspect import iscoroutinefunction
from typing import Any

from ces_observer.limits import NodeLimits

MAX_KINDS = 100  # kinds of failures that are logged
MAX_LENGTH = 300  # characters of a failure in diagnostics
GUARDED = "is_guarded"  # attribute of a function that `Guard.wrap` returned


class Guard:
    """Runs callbacks; `count` failures so far, `last` the newest in words.

    `log` receives the text of each new kind of failure. Exceptions of the types in `passing` leave the callback, as
    those that are no Exception do (KeyboardInterrupt, SystemExit). Nothing is a failure once `is_ending()`.
    """

    def __init__(
        self,
        log: Callable[[str], None],
        passing: tuple[type[Exception], ...] = (),
        is_ending: Callable[[], bool] = lambda: False,
    ) -> None:
        self._log, self._passing, self._is_ending = log, passing, is_ending
        self._kinds: set[tuple[str, ...]] = set()
        self.count, self.last = 0, "none"
        self._remarked = 0

    def wrap(
        self,
        callback: Callable[..., Any],
        on_failure: Callable[[], None] | None = None,
        answer_failure: Callable[..., Any] | None = None,
    ) -> Callable[..., Any]:
        """Return `callback` as a function that does not raise.

        After a failure it calls `on_failure()`, then returns `answer_failure(*arguments)`, None without one. Raises
        TypeError for a coroutine function: executors of rclpy 7.1.4 to 7.1.10 do not await it.
        """
        if iscoroutinefunction(callback):
            raise TypeError(f"{callback} is a coroutine function; expected a callback that returns at once")

        @wraps(callback)
        def guarded(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                self.catch(error, on_failure)
                return None if answer_failure is None else answer_failure(*arguments)

        setattr(guarded, GUARDED, True)
        return guarded

    def call(self, step: Callable[[], Any]) -> None:
        """Run `step`; count and report its failure."""
        try:
            step()
        except Exception as error:
            self.catch(error)

    def catch(self, error: Exception, on_failure: Callable[[], None] | None = None) -> None:
        """Count and report a failure, then call `on_failure()`; raise it instead if its type is in `passing`."""
        if isinstance(error, self._passing):
            raise error
        self.take(error)
        if on_failure is not None:
            self.call(on_failure)

    def take(self, error: Exception) -> None:
        """Count a failure, and report it if it is of a new kind. Never raises."""
        with suppress(Exception):  # such as no memory, or no logger any more
            if self._is_ending():
                return
            self.count += 1
            self.last = f"{type(error).__name__}: {error}"[:MAX_LENGTH]
            frames = traceback.extract_tb(error.__traceback__)
            kind = (type(error).__name__, *(f"{one.filename}:{one.lineno}" for one in frames[-1:]))
            if kind not in self._kinds and len(self._kinds) < MAX_KINDS:
                self._kinds.add(kind)
                lines = "".join(traceback.format_exception(error, limit=-20))
                self._log(f"unexpected error, logged once and counted in the diagnostics; the node runs on:\n{lines}")

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the key-value pairs for diagnostics."""
        return (("unexpected errors", f"{self.count}, the last: {self.last}"),)

    def take_remark(self) -> str:
        """Return a remark for diagnostics on failures since the last call, empty if there were none."""
        if self.count == self._remarked:
            return ""
        self._remarked = self.count
        return f"{self.count} unexpected errors, the last: {self.last}"


LAST_TYPE = 9  # of rcl_interfaces/msg/ParameterType: an array of strings
LISTS = ("names", "prefixes", "parameters")
VALUES = ("string_value", *(f"{kind}_array_value" for kind in ("byte", "bool", "integer", "double", "string")))


def find_excess(request: Any) -> str:
    """Return in what a request exceeds the limits, empty if in nothing."""
    excesses = (_find_excess_of(one) for name in LISTS for one in getattr(request, name, ()))
    return find_too_many(request) or next(filter(None, excesses), "")


def find_too_many(request: Any) -> str:
    """Return of what there are too many in a request, empty if of nothing."""
    for name in LISTS:
        count = len(getattr(request, name, ()))
        if count > NodeLimits.MAX_NAMES:
            return f"{count} {name} in one request; expected at most {NodeLimits.MAX_NAMES}"
    return ""


def _find_excess_of(one: Any) -> str:
    """Return in what one name or parameter exceeds the limits, or that its value has no type."""
    name = one if isinstance(one, str) else one.name
    if len(name) > NodeLimits.MAX_NAME_LENGTH:
        return f"a parameter's name of {len(name)} characters; expected at most {NodeLimits.MAX_NAME_LENGTH}"
    if isinstance(one, str):
        return ""
    if one.value.type > LAST_TYPE:
        return f"parameter '{name}' has a value of unknown type {one.value.type}"
    longest = max(len(getattr(one.value, field)) for field in VALUES)
    if longest > NodeLimits.MAX_VALUE_LENGTH:
        return (
            f"parameter '{name}' has {longest} characters or elements; expected at most {NodeLimits.MAX_VALUE_LENGTH}"
        )
    if any(len(text) > NodeLimits.MAX_VALUE_LENGTH for text in one.value.string_array_value):
        return f"parameter '{name}' has a string of more than {NodeLimits.MAX_VALUE_LENGTH} characters; expected fewer"
    return ""
