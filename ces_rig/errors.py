"""Errors of the virtual rig."""

from ces_observer.errors import CesError


class RigError(CesError):
    """A damper or experiment description that cannot be used."""
