"""A polynomial NARX run tick by tick: position, speed and current in, force out, from its own past forces."""

from __future__ import annotations

from collections import deque
from math import inf

from ces_observer.model import Factor, Model, Term

Power = tuple[int, float, bool]  # index into (position, speed, current), power, signed
COLUMNS = {"position": 0, "speed": 1, "current": 2}


class Polynomial:
    """The free run of a model; `clamped` tells whether the last tick's inputs were outside the envelope."""

    __slots__ = ("_bounds", "_depth", "_forces", "_limits", "_powers", "_rows", "_terms", "clamped")

    def __init__(self, model: Model) -> None:
        inputs = [factor for term in model.terms for factor in term.inputs]
        self._powers: list[Power] = sorted({_power(factor) for factor in inputs})
        self._terms = [self._compiled(term) for term in model.terms]
        e = model.envelope
        self._bounds = (*e.position_m, *e.speed_m_s, *e.current_A)
        self._limits = model.force_envelope_N
        self._depth = model.max_lag + 1
        self.reset()

    def reset(self) -> None:
        """Forget the past: forces before now count as zero, inputs before now as the first ones to come."""
        self._rows: deque[list[float]] = deque(maxlen=self._depth)
        self._forces: deque[float] = deque([0.0] * self._depth, maxlen=self._depth)
        self.clamped = False

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick; infinite if it left the force envelope."""
        row = self._row(position, speed, current)
        rows, forces = self._rows, self._forces
        if not rows:
            rows.extend([row] * self._depth)
        rows.appendleft(row)
        force = 0.0
        for coefficient, factors, lag in self._terms:
            product = coefficient
            for back, column in factors:
                product *= rows[back][column]
            force += product * forces[lag - 1] if lag else product
        forces.appendleft(force)
        low, high = self._limits
        return force if low <= force <= high else inf

    def _row(self, position: float, speed: float, current: float) -> list[float]:
        x0, x1, v0, v1, c0, c1 = self._bounds
        x = x0 if position < x0 else x1 if position > x1 else position
        v = v0 if speed < v0 else v1 if speed > v1 else speed
        c = c0 if current < c0 else c1 if current > c1 else current
        self.clamped = x != position or v != speed or c != current
        values = (x, v, c)
        row = []
        for column, power, signed in self._powers:
            value = values[column]
            magnitude: float = abs(value) ** power
            row.append(-magnitude if signed and value < 0.0 else magnitude)
        return row

    def _compiled(self, term: Term) -> tuple[float, tuple[tuple[int, int], ...], int]:
        factors = tuple((f.lag, self._powers.index(_power(f))) for f in term.inputs)
        return term.coefficient, factors, term.output_lag


def _power(factor: Factor) -> Power:
    return COLUMNS[factor.signal], factor.power, factor.signed
