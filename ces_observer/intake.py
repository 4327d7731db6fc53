"""Samples on their way to the estimator: positions may wait until their current is known.

In a burst, as when a bag is replayed, a position is often read before its current, and the force would depend on which
queue was read first. A position that waits for a current stamped no earlier gives a force that depends on the stamps
alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from ces_observer.current_hold import ConstantCurrent
from ces_observer.damper_observer import DamperObserver
from ces_observer.limits import ClockLimits

MAX_POSITIONS = 10_000  # samples: several seconds at 1 kHz; beyond it the oldest is released
OnEstimate = Callable[[int, bytes, float | None], None]  # stamp [ns], frame, force [N] if there is one


class Intake:
    """Feeds the observer of a damper; `on_estimate` is called after each position, in the order of their arrival.

    `now_ns` is the node's clock when a sample arrived.
    """

    def __init__(self, damper: DamperObserver, on_estimate: OnEstimate) -> None:
        self._damper, self._on_estimate = damper, on_estimate
        self._queue: deque[tuple[int, float, bytes, int]] = deque()  # stamp, position, frame, arrival
        self._wait_ns = self._position_ns = 0  # the latter: stamp of the last position

    def set_wait(self, wait_s: float) -> None:
        """Hold positions back for at most `wait_s` [s] until their current is known; a constant current always is."""
        measured = bool(self._damper.motions) or not isinstance(self._damper.current, ConstantCurrent)
        self._wait_ns = round(wait_s * 1e9) if measured else 0

    def take_current(self, stamp_ns: int, current_A: float, now_ns: int) -> None:
        """Take a current [A]."""
        if self._damper.current.shows_jump(stamp_ns):
            self._release_all(now_ns)
        self._damper.take_current(stamp_ns, current_A)
        self.release(now_ns)

    def take_motion(self, name: str, stamp_ns: int, value: float, now_ns: int) -> None:
        """Take a "speed" [m/s] or "acceleration" [m/s2]."""
        if self._damper.motions[name].shows_jump(stamp_ns):
            self._release_all(now_ns)
        self._damper.take_motion(name, stamp_ns, value)
        self.release(now_ns)

    def take_position(self, stamp_ns: int, position_m: float, frame: bytes, now_ns: int) -> None:
        """Take a position [m]."""
        jump_ns = self._position_ns - ClockLimits.JUMP_NS
        if stamp_ns < jump_ns:
            self._release_all(now_ns)
            self._damper.forget_inputs(jump_ns)
        self._position_ns = stamp_ns
        if self._wait_ns or self._queue:
            self._queue.append((stamp_ns, position_m, frame, now_ns))
            self.release(now_ns)
        else:
            self._on_estimate(stamp_ns, frame, self._damper.step(stamp_ns, position_m, now_ns))

    def release(self, now_ns: int) -> None:
        """Estimate from the positions whose wait for all measured signals that the model needs is over.

        A clock that was set back ends the wait, too. A position that arrived before simulated time began, at 0, waits
        from now.
        """
        queue = self._queue
        while queue:
            stamp_ns, position_m, frame, arrived_ns = queue[0]
            if not arrived_ns:
                arrived_ns = now_ns
                queue[0] = (stamp_ns, position_m, frame, now_ns)
            waits = abs(now_ns - arrived_ns) < self._wait_ns and len(queue) <= MAX_POSITIONS
            if waits and not self._is_known(stamp_ns):
                return
            self._estimate_first(now_ns)

    def reset(self, now_ns: int) -> None:
        """Restart after a time jump; positions held back belong to the time before it."""
        self._release_all(now_ns)
        self._damper.reset()

    def restart(self) -> None:
        """Begin anew after a failure, which may have left an estimator half changed."""
        self._queue.clear()
        self._damper.restart()

    def _is_known(self, stamp_ns: int) -> bool:
        needed = (self._damper.current, self._damper.motion)
        return all(
            isinstance(one, ConstantCurrent) or (one.newest_ns is not None and one.newest_ns >= stamp_ns)
            for one in needed
        )

    def _release_all(self, now_ns: int) -> None:
        """Estimate from all positions that wait: after a jump of the stamps no current of their time comes."""
        while self._queue:
            self._estimate_first(now_ns)

    def _estimate_first(self, now_ns: int) -> None:
        stamp_ns, position_m, frame, _ = self._queue.popleft()
        self._on_estimate(stamp_ns, frame, self._damper.step(stamp_ns, position_m, now_ns))
