"""A polynomial NARX run tick by tick: position, speed and current in, force out, from its own past forces."""

from __future__ import annotations

from math import copysign, inf, prod

from ces_observer.model import Factor, Model, Term

Power = tuple[int, float, bool]  # index into (position, speed, current), power, signed
COLUMNS = {"position": 0, "speed": 1, "current": 2}


class Polynomial:
    """The free run of a model; `clamped` tells whether the last tick's inputs were outside the envelope.

    Each power of an input is computed once, when it arrives, and kept for the lags; terms are sorted by their number
    of factors so that the common ones need no inner loop.
    """

    __slots__ = (
        "_bounds",
        "_constant",
        "_depth",
        "_forces",
        "_limits",
        "_long",
        "_ones",
        "_outputs_one",
        "_outputs_two",
        "_powers",
        "_rows",
        "_twos",
        "clamped",
    )

    def __init__(self, model: Model) -> None:
        inputs = [factor for term in model.terms for factor in term.inputs]
        self._powers: list[Power] = sorted({_power(factor) for factor in inputs})
        self._sort(model.terms)
        e = model.envelope
        self._bounds = (*e.position_m, *e.speed_m_s, *e.current_A)
        self._limits = model.force_envelope_N
        self._depth = model.max_lag + 1
        self.reset()

    def reset(self) -> None:
        """Forget the past: forces before now count as zero, inputs before now as the first ones to come."""
        self._rows: list[list[float]] = []
        self._forces = [0.0] * self._depth
        self.clamped = False

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick; infinite if it left the force envelope."""
        row = self._row(position, speed, current)
        rows, forces = self._rows, self._forces
        if not rows:
            rows.extend([row] * (self._depth + 1))
        rows.insert(0, row)
        rows.pop()
        force = self._constant
        for c, i, a in self._ones:
            force += c * rows[i][a]
        for c, i, a, j, b in self._twos:
            force += c * rows[i][a] * rows[j][b]
        for c, lag, i, a in self._outputs_one:
            force += c * forces[lag] * rows[i][a]
        for c, lag, i, a, j, b in self._outputs_two:
            force += c * forces[lag] * rows[i][a] * rows[j][b]
        for c, lag, factors in self._long:
            force += (forces[lag] if lag >= 0 else 1.0) * prod([rows[i][a] for i, a in factors], start=c)
        forces.insert(0, force)
        forces.pop()
        low, high = self._limits
        return force if low <= force <= high else inf

    def _row(self, position: float, speed: float, current: float) -> list[float]:
        """Return every power of the inputs, clamped to the envelope."""
        x0, x1, v0, v1, c0, c1 = self._bounds
        if x0 <= position <= x1 and v0 <= speed <= v1 and c0 <= current <= c1:
            self.clamped = False
            values = (position, speed, current)
        else:
            self.clamped = True
            values = (min(max(position, x0), x1), min(max(speed, v0), v1), min(max(current, c0), c1))
        magnitudes = (abs(values[0]), abs(values[1]), abs(values[2]))
        return [
            copysign(magnitudes[column] ** power, values[column]) if signed else magnitudes[column] ** power
            for column, power, signed in self._powers
        ]

    def _sort(self, terms: tuple[Term, ...]) -> None:
        """Put each term with those of its shape; a past force `lag` ticks ago is forces[lag - 1]."""
        self._constant = 0.0
        self._ones: list[tuple[float, int, int]] = []
        self._twos: list[tuple[float, int, int, int, int]] = []
        self._outputs_one: list[tuple[float, int, int, int]] = []
        self._outputs_two: list[tuple[float, int, int, int, int, int]] = []
        self._long: list[tuple[float, int, list[tuple[int, int]]]] = []
        for term in terms:
            c, lag = term.coefficient, term.output_lag - 1
            factors = [(f.lag, self._powers.index(_power(f))) for f in term.inputs]
            match factors:
                case [] if lag < 0:
                    self._constant += c
                case [(i, a)] if lag < 0:
                    self._ones.append((c, i, a))
                case [(i, a), (j, b)] if lag < 0:
                    self._twos.append((c, i, a, j, b))
                case [(i, a)]:
                    self._outputs_one.append((c, lag, i, a))
                case [(i, a), (j, b)]:
                    self._outputs_two.append((c, lag, i, a, j, b))
                case _:
                    self._long.append((c, lag, factors))


def _power(factor: Factor) -> Power:
    return COLUMNS[factor.signal], factor.power, factor.signed
