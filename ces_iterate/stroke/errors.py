"""Errors of the learning of strokes."""

from ces_iterate.errors import IterateError


class StrokeError(IterateError):
    """A plan, a stroke or a recording from which no command can be learned."""
