"""Errors of rigs."""

from ces_observer.errors import CesError


class RigError(CesError):
    """A description or plan that cannot be used, or a rig that did not record what was asked of it."""
