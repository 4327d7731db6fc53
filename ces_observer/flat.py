"""A model laid out as flat arrays of numbers, for the functions of `ces_observer.tick`.

A structure fills an `ArrayLayout`: its named numbers at the places that its tick declares, then tables of any length.
The names of places are declared once, in `tick/`; nobody writes a number for a place.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import NamedTuple

from ces_observer.errors import ModelError


class Arrays(NamedTuple):
    """The four arrays of a function of the tick: numbers and whole numbers of a model, and its state."""

    p: Sequence[float]
    n: Sequence[int]
    s: Sequence[float]
    k: Sequence[int]


class ArrayLayout:
    """Collects the numbers of a model: p, n, and the sizes of s and k.

    `numbers`, `counts`, `states` and `flags` are the sizes of the named parts, at whose places p and n are assigned.
    """

    def __init__(self, numbers: int, counts: int, states: int, flags: int) -> None:
        self.p, self.n = [0.0] * numbers, [0] * counts
        self.states, self.flags = states, flags

    def reserve(self, numbers: int, counts: int, states: int, flags: int) -> None:
        """Make room for named parts of these sizes; call it before tables are appended."""
        self.p.extend([0.0] * (numbers - len(self.p)))
        self.n.extend([0] * (counts - len(self.n)))
        self.states, self.flags = max(states, self.states), max(flags, self.flags)

    def put(self, place: int, values: Iterable[float]) -> None:
        """Set numbers one after the other from a named place of p on."""
        for i, value in enumerate(values):
            self.p[place + i] = value

    def table(self, values: Iterable[float]) -> int:
        """Append numbers to p; return the place of the first."""
        place = len(self.p)
        self.p.extend(map(float, values))
        return place

    def indices(self, values: Iterable[int]) -> int:
        """Append whole numbers to n; return the place of the first."""
        place = len(self.n)
        self.n.extend(map(int, values))
        return place

    def state(self, count: int) -> int:
        """Reserve numbers of the state s; return the place of the first."""
        self.states += count
        return self.states - count

    def memory(self, count: int) -> int:
        """Reserve whole numbers of the state k; return the place of the first."""
        self.flags += count
        return self.flags - count

    def arrays(self) -> Arrays:
        """Return p, n and a new state of zeros. Raises ModelError if a number is not finite."""
        numbers, counts = list(map(float, self.p)), list(map(int, self.n))
        for value in numbers:
            if not isfinite(value):
                raise ModelError(f"the model holds {value!r}; expected finite numbers only: identify the model again")
        return Arrays(numbers, counts, [0.0] * self.states, [0] * self.flags)
