"""The error of this package."""

from ces_observer.errors import CesError


class GapError(CesError):
    """A diagnosis is not possible; the message says what is wrong, where, what was expected and what to do."""
