"""Errors of the learning of strokes."""

from ces_observer.errors import CesError


class StrokeError(CesError):
    """A plan, a stroke or a recording from which no command can be learned."""
