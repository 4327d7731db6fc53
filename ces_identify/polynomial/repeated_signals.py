"""The factors of one signal in a product that names it once or several times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

from ces_observer.structures.terms import Factor

MAX_CHOICES = 100_000  # combinations of factors that are tried


def choose_factors(occurrences: Sequence[Sequence[Factor]]) -> list[tuple[Factor, ...]]:
    """Return the choices of one factor for each occurrence of a signal, each choice once.

    The factors have different lags, except that a magnitude and a sign at one lag become one signed factor.
    """
    merged = (merge_signs(choice) for choice in product(*occurrences))
    usable = [choice for choice in merged if len({factor.lag for factor in choice}) == len(choice)]
    return list({frozenset(choice): choice for choice in reversed(usable)}.values())[::-1]


def merge_signs(choice: Sequence[Factor]) -> tuple[Factor, ...]:
    """Return the factors with |s|^p and sign(s) of one signal at one lag as sign(s) |s|^p."""
    signs = [f for f in choice if f.signed and f.power == 0.0]
    merged = list(choice)
    for sign in signs:
        size = next((f for f in merged if (f.signal, f.lag) == (sign.signal, sign.lag) and not f.signed), None)
        if size is not None:
            merged.remove(sign)
            merged[merged.index(size)] = replace(size, signed=True)
    return tuple(merged)
