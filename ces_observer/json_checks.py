"""Checked reading of untrusted JSON, one value at a time, and writing of files as a whole or not at all."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ces_observer.errors import CesError, ModelError


class JsonObject:
    """A JSON object and its place in a file, which every error names; getters raise ModelError."""

    def __init__(self, value: object, where: str) -> None:
        if not isinstance(value, Mapping):
            raise ModelError(f"{where}: found {_shorten(value)}; expected an object")
        self.value = value
        self.where = where

    def require_only_keys(self, *keys: str) -> None:
        """Raise ModelError if there is a key that is not in `keys`, such as a misspelt one."""
        unknown = next((key for key in self.value if key not in keys), None)
        if unknown is not None:
            raise ModelError(f"{self.where}: unknown key {_shorten(unknown)}; known are {', '.join(keys)}")

    def at(self, key: str) -> JsonObject:
        """Return the object under `key`."""
        return JsonObject(self._get(key), f"{self.where}: {key}")

    def items(self, key: str, min_count: int, max_count: int) -> Iterator[JsonObject]:
        """Yield the objects of the list under `key`."""
        value = self._get(key)
        if not isinstance(value, list) or not min_count <= len(value) <= max_count:
            raise self._value_error(key, f"a list of {min_count} to {max_count} objects")
        return (JsonObject(item, f"{self.where}: {key}[{i}]") for i, item in enumerate(value))

    def text(self, key: str) -> str:
        """Return the string under `key`."""
        value = self._get(key)
        if not isinstance(value, str):
            raise self._value_error(key, "a string")
        return value

    def choice(self, key: str, among: Sequence[str]) -> str:
        """Return the string under `key`, one of `among`."""
        value = self._get(key)
        if not isinstance(value, str) or value not in among:
            raise self._value_error(key, "one of " + ", ".join(among))
        return value

    def number(self, key: str, low: float = -math.inf, high: float = math.inf) -> float:
        """Return the finite number under `key`, within [low, high]."""
        value = self._get(key)
        if not _is_finite(value) or not low <= value <= high:
            bounds = "" if math.isinf(high) else f" from {low:g} to {high:g}"
            raise self._value_error(key, f"a finite number{bounds}")
        return float(value)

    def integer(self, key: str, low: int, high: int) -> int:
        """Return the whole number under `key`, within [low, high]."""
        value = self._get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self._value_error(key, f"a whole number from {low} to {high}")
        return value

    def flag(self, key: str) -> bool:
        """Return the boolean under `key`."""
        value = self._get(key)
        if not isinstance(value, bool):
            raise self._value_error(key, "true or false")
        return value

    def range(self, key: str, max_magnitude: float = math.inf) -> tuple[float, float]:
        """Return the pair [low, high] of finite numbers under `key`, neither larger than `max_magnitude`."""
        value = self._get(key)
        pair = (
            isinstance(value, list)
            and len(value) == 2
            and all(_is_finite(v) and abs(v) <= max_magnitude for v in value)
        )
        if not pair or value[0] > value[1]:
            raise self._value_error(key, f"[low, high], both finite and at most {max_magnitude:g}")
        return float(value[0]), float(value[1])

    def numbers(self, key: str, count: int, max_magnitude: float) -> tuple[float, ...]:
        """Return the list of `count` finite numbers under `key`, none larger than `max_magnitude`."""
        value = self._get(key)
        good = isinstance(value, list) and all(_is_finite(v) and abs(v) <= max_magnitude for v in value)
        if not good or len(value) != count:
            raise self._value_error(key, f"a list of {count} finite numbers, each at most {max_magnitude:g}")
        return tuple(map(float, value))

    def mapping_or_none(self, key: str) -> Mapping[str, Any] | None:
        """Return the object under `key`, or None if it is null."""
        value = self._get(key)
        if value is not None and not isinstance(value, Mapping):
            raise self._value_error(key, "an object or null")
        return value

    def _get(self, key: str) -> Any:
        if key not in self.value:
            raise ModelError(f"{self.where}: key '{key}' is missing")
        return self.value[key]

    def _value_error(self, key: str, expected: str) -> ModelError:
        return ModelError(f"{self.where}: {key} is {_shorten(self.value[key])}; expected {expected}")


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write `content` (a string as UTF-8) to a temporary file beside `path` and rename that.

    Raises CesError naming the path if the folder is missing, read-only or full; `path` is then unchanged.
    """
    write_all_atomically({Path(path): content})


def write_all_atomically(files: Mapping[Path, str | bytes]) -> None:
    """Write files that belong together like `write_atomically`: none is renamed before all are written."""
    ready: dict[Path, Path] = {}
    try:
        for path, content in files.items():
            _write_temporary(path, content, ready)
        for path, temporary in ready.items():
            with _explain_write_errors(path):
                temporary.replace(path)
    finally:
        for temporary in ready.values():
            temporary.unlink(missing_ok=True)


def _write_temporary(path: Path, content: str | bytes, ready: dict[Path, Path]) -> None:
    """Write a temporary file beside `path`; `ready` names it as soon as it exists."""
    with _explain_write_errors(path):
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        ready[path] = Path(temporary)
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode("utf-8") if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        ready[path].chmod(0o644)


@contextmanager
def _explain_write_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise CesError(f"{path}: cannot be written: {error.strerror}; choose a writable folder") from None


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -1.7e308 < value < 1.7e308


def _shorten(value: object) -> str:
    text = repr(value[:60] if isinstance(value, str) else value)
    return text if len(text) <= 60 else text[:57] + "..."
