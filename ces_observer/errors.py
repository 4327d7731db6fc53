"""The common base of all errors that a user can correct."""


class CesError(Exception):
    """One line: what is wrong, where, what was expected, what to do. Programs print it and exit with status 2."""


class SignalsError(CesError):
    """A signals description that cannot be used."""


class ModelError(CesError):
    """A model file that cannot be used."""


class RecordingError(CesError):
    """A recording that cannot be read, or whose samples cannot be used."""
