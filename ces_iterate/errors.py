"""Errors of the rig in the loop."""

from __future__ import annotations

from ces_observer.errors import CesError


class IterateError(CesError):
    """A plan that cannot be used, or a rig that did not record what was asked of it."""
