"""What gives way in series with a damper, and the springs that yield behind it."""

from __future__ import annotations

from math import inf

from ces_observer.structures.physical import FrictionElement


class MountRun:
    """What gives way in series, `give` [m/s/N] a tick, and the springs that yield behind it.

    With `left` the speed behind the mount if those springs kept their forces, the speed there is share (left + shift).
    """

    def __init__(
        self, elements: tuple[FrictionElement, ...], mount: float, creep_m_Ns: float, interval_s: float
    ) -> None:
        self._mount, self.give = mount, mount + creep_m_Ns
        self._elements = [(one.stiffness_N_m * interval_s, one.yield_N, one.moved_N) for one in elements]
        self._share = 1.0 / (1.0 + self.give * sum(step for step, _, _ in self._elements))
        self.reset()

    def reset(self) -> None:
        """Forget the past: no force."""
        self.forces = [0.0] * len(self._elements)
        self._limits = list(self.forces)
        self.rubbed = self.pull = 0.0

    def begin(self, drive: float, setting: float) -> float:
        """Begin a tick at a setting of the valve; return the speed [m/s] if the network's force were 0."""
        forces, limits, total = self.forces, self._limits, 0.0
        for n, (_, least, moved) in enumerate(self._elements):
            limits[n] = limit = least + setting * moved
            if forces[n] > limit:
                forces[n] = limit
            elif forces[n] < -limit:
                forces[n] = -limit
            total += forces[n]
        return drive + self._mount * self.pull - self.give * total

    def find(self, left: float) -> tuple[float, float, float, float]:
        """Return shift and share at `left` [m/s], and the range of speeds in which they hold."""
        reaches, least, share = [], inf, self._share
        for (step, _, _), force, limit in zip(self._elements, self.forces, self._limits, strict=True):
            change = limit - force if left > 0.0 else limit + force
            reach = change / step
            least = min(least, reach)
            reaches.append((reach, step, change))
        if abs(share * left) <= least:
            return (0.0, share, 0.0, least) if left > 0.0 else (0.0, share, -least, 0.0)
        reaches.sort()
        held, holding = 0.0, []
        for _, step, _ in reversed(reaches):
            holding.append(held)
            held += step
        give, shift, low = (-self.give if left > 0.0 else self.give), 0.0, 0.0
        for reach, _, change in reaches:
            if abs(share * (left + shift)) <= reach:
                return (shift, share, low, reach) if left > 0.0 else (shift, share, -reach, -low)
            shift += give * change
            share, low = 1.0 / (1.0 + self.give * holding.pop()), reach
        return (shift, share, low, inf) if left > 0.0 else (shift, share, -inf, -low)

    def end(self, way: float, pull_N: float) -> None:
        """End the tick with the speed [m/s] behind the mount and the network's force [N]."""
        total, forces, limits = 0.0, self.forces, self._limits
        for n, (step, _, _) in enumerate(self._elements):
            force, limit = forces[n] + step * way, limits[n]
            if force > limit:
                force = limit
            elif force < -limit:
                force = -limit
            forces[n] = force
            total += force
        self.rubbed, self.pull = total, pull_N + total
