"""The observer node with defects: parts of it raise again and again, as no tested code should.

Run as the node itself is. Which part fails, and when, is the same in each run.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import count
from typing import Any

from rclpy.service import Service

from ces_observer.damper_observer import DamperObserver
from ces_observer.health.diagnostics import Latencies
from ces_observer.health.health import Health
from ces_observer.nodes import model_changes, observer
from ces_observer.nodes.model_check import ModelReload
from ces_observer.nodes.outputs import DiagnosticsOutput

STEPS = 1500  # samples from one failure of the estimator to the next
WRONG_M = 0.005  # by which the estimator is off after a failure


def fail_each(kind: type, name: str, period: int, error: Callable[[], Exception]) -> None:
    """Let the method `name` of a class raise at each `period`-th call."""
    real, calls = getattr(kind, name), count(1)

    def failing(*arguments: Any, **options: Any) -> Any:
        if next(calls) % period == 0:
            raise error()
        return real(*arguments, **options)

    setattr(kind, name, failing)


def fail_half_way() -> None:
    """Let the estimator fail after it has taken a wrong position: its next forces would be wrong."""
    real, calls = DamperObserver.step, count(1)

    def failing(self: DamperObserver, stamp_ns: int, position_m: float, now_ns: int) -> float | None:
        if next(calls) % STEPS == 0:
            real(self, stamp_ns, position_m + WRONG_M, now_ns)
            raise MemoryError("planted in the estimator")
        return real(self, stamp_ns, position_m, now_ns)

    DamperObserver.step = failing  # type: ignore[method-assign]


def hang() -> ModelReload:
    """Return checks of models that hang."""
    return ModelReload(("-c", "import time; time.sleep(60)"), longest_s=0.5)


def refuse(*arguments: Any) -> str:
    raise KeyError("planted in the check of parameters")


def main() -> int:
    fail_half_way()
    fail_each(DiagnosticsOutput, "publish", 3, lambda: OSError(28, "planted in the diagnostics"))
    fail_each(Health, "roll", 2, lambda: RecursionError("planted in a timer"))
    fail_each(Latencies, "take", 3, lambda: ValueError("planted in the health"))
    fail_each(Service, "send_response", 2, lambda: RuntimeError("planted in rclpy"))
    model_changes.ModelReload = hang  # type: ignore[assignment,misc]
    observer.check_live_values = refuse
    return observer.main()


if __name__ == "__main__":
    sys.exit(main())
