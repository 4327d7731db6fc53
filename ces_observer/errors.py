"""The one error family: a mistake in what the user gave, told in a line they can act on."""


class CesError(Exception):
    """What is wrong, where, what was expected and what to do, in one line; programs print it and exit with status 2."""


class SignalsError(CesError):
    """A signals description that cannot be used."""


class ModelError(CesError):
    """A model file that cannot be used."""


class RecordingError(CesError):
    """A recording that cannot be read, or whose samples cannot be used."""
