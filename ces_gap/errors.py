"""The package's family of errors."""

from ces_observer.errors import CesError


class GapError(CesError):
    """A diagnosis cannot be made of what was given; the message says what, where, what was expected and what to do."""
