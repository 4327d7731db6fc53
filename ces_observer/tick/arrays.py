"""The two kinds of arrays of the subset: a list, an `array.array` or a NumPy array, given by the caller.

A function of the tick takes them by the names p and n (numbers and whole numbers of the model, which it only reads), s
and k (its state).
"""

from collections.abc import MutableSequence
from typing import Any, TypeVar, cast

T = TypeVar("T", float, int)

Floats = list[float]
Ints = list[int]


class Part:
    """The part of an array from a place on, which shares its elements; `part` gives it."""

    __slots__ = ("array", "at")

    def __init__(self, array: MutableSequence[Any], at: int) -> None:
        self.array, self.at = array, at

    def __getitem__(self, place: int) -> Any:
        return self.array[self.at + place]

    def __setitem__(self, place: int, value: Any) -> None:
        self.array[self.at + place] = value


def part(array: list[T], at: int) -> list[T]:
    """Return an array's part from array[at] on, as the argument of a call; in C, a pointer to there."""
    return cast("list[T]", Part(array, at))
