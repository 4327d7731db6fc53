"""Untrusted JSON from a file or a topic: parsed strictly, read value by value; files written as a whole or not at all.

Values are bounded in size and depth. Unlike the `json` module, `parse_json` rejects repeated keys, NaN, infinities, and
strings that UTF-8 cannot encode.
"""

from __future__ import annotations

import atexit
import json
import os
import stat
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from errno import EDQUOT, ENOSPC
from math import inf, isfinite, isinf
from pathlib import Path
from typing import Any

from ces_observer.errors import CesError, ModelError

DEEPEST = 32
LONGEST_TEXT = 10_000
LARGEST_WHOLE = 2**63


def read_bounded(path: Path, max_bytes: int) -> str:
    """Return the text of a file, reading at most `max_bytes` and one more.

    Raises OSError, and ModelError naming the file if it is not a regular file, too large or not UTF-8.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise ModelError(f"{path}: not a regular file; expected a JSON file")
    except ValueError as error:  # a NUL in the name
        raise ModelError(f"{str(path)!r}: not a file name: {error}") from None
    with path.open("rb") as file:
        raw = file.read(max_bytes + 1)
    if len(raw) > max_bytes:
        raise ModelError(f"{path}: too large; a model file has at most {max_bytes} bytes")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None


def parse_json(text: str, source: str) -> Any:
    """Return the values of a JSON text; `source` names it in errors. Raises ModelError."""
    try:
        values = json.loads(text, object_pairs_hook=_object)
    except RecursionError:
        raise _too_deep_error(source) from None
    except ValueError as error:
        raise ModelError(f"{source}: not a JSON file: {error}") from None
    _check(values, source, DEEPEST)
    return values


def _too_deep_error(where: str) -> ModelError:
    return ModelError(f"{where}: nested more than {DEEPEST} deep; expected a file that `ces identify` wrote")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"key {_start_of(twice)} occurs twice; keep one")
    return values


def _check(value: object, where: str, depth: int) -> None:
    """Raise ModelError at a value that is too deep, too long, too large, or cannot be written again."""
    if isinstance(value, dict | list) and depth == 0:
        raise _too_deep_error(where[:200])
    match value:
        case str():
            _check_text(value, where)
        case list():
            for i, one in enumerate(value):
                _check(one, f"{where}[{i}]", depth - 1)
        case dict():
            for key, one in value.items():
                _check_text(key, where)
                _check(one, f"{where}: {key if len(key) < 40 and key.isprintable() else _start_of(key)}", depth - 1)
        case float() if not isfinite(value):
            raise ModelError(f"{where} is {value!r}; expected a finite number")
        case int() if abs(value) > LARGEST_WHOLE:
            raise ModelError(f"{where} is a whole number beyond 2^63; expected a smaller one")


def _check_text(text: str, where: str) -> None:
    if len(text) > LONGEST_TEXT:
        raise ModelError(f"{where}: a string of {len(text)} characters; expected at most {LONGEST_TEXT}")
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise ModelError(f"{where}: {_start_of(text)} has half of a surrogate pair; expected whole characters")


def _start_of(text: str) -> str:
    return repr(text[:40])


class JsonObject:
    """A JSON object and its place in a file, which every error names; getters raise ModelError."""

    def __init__(self, value: object, where: str) -> None:
        if not isinstance(value, Mapping):
            raise ModelError(f"{where}: found {quote(value)}; expected an object")
        self.value = value
        self.where = where

    def require_only_keys(self, *keys: str) -> None:
        """Raise ModelError if there is a key that is not in `keys`, such as a misspelt one."""
        unknown = next((key for key in self.value if key not in keys), None)
        if unknown is not None:
            raise ModelError(f"{self.where}: unknown key {quote(unknown)}; known are {', '.join(keys)}")

    def at(self, key: str) -> JsonObject:
        """Return the object under `key`."""
        return JsonObject(self._get(key), f"{self.where}: {key}")

    def items(self, key: str, min_count: int, max_count: int) -> Iterator[JsonObject]:
        """Yield the objects of the list under `key`."""
        expected = f"a list of {min_count} to {max_count} objects"
        value = self._get(key, lambda v: isinstance(v, list) and min_count <= len(v) <= max_count, expected)
        return (JsonObject(item, f"{self.where}: {key}[{i}]") for i, item in enumerate(value))

    def text(self, key: str) -> str:
        """Return the string under `key`."""
        return str(self._get(key, lambda v: isinstance(v, str), "a string"))

    def choice(self, key: str, among: Sequence[str]) -> str:
        """Return the string under `key`, one of `among`."""
        return str(self._get(key, lambda v: isinstance(v, str) and v in among, "one of " + ", ".join(among)))

    def number(self, key: str, low: float = -inf, high: float = inf) -> float:
        """Return the finite number under `key`, within [low, high]."""
        bounds = "" if isinf(high) else f" from {low:g} to {high:g}"
        return float(self._get(key, lambda v: _is_finite(v) and low <= v <= high, f"a finite number{bounds}"))

    def integer(self, key: str, low: int, high: int) -> int:
        """Return the whole number under `key`, within [low, high]."""
        expected = f"a whole number from {low} to {high}"
        return int(self._get(key, lambda v: type(v) is int and low <= v <= high, expected))

    def flag(self, key: str) -> bool:
        """Return the boolean under `key`."""
        return bool(self._get(key, lambda v: isinstance(v, bool), "true or false"))

    def range(self, key: str, max_magnitude: float = inf) -> tuple[float, float]:
        """Return the pair [low, high] of finite numbers under `key`, neither larger than `max_magnitude`."""
        expected = f"[low, high], both finite and at most {max_magnitude:g}"
        low, high = self._get(key, lambda v: _are_finite(v, 2, max_magnitude) and v[0] <= v[1], expected)
        return float(low), float(high)

    def numbers(self, key: str, count: int, max_magnitude: float) -> tuple[float, ...]:
        """Return the list of `count` finite numbers under `key`, none larger than `max_magnitude`."""
        expected = f"a list of {count} finite numbers, each at most {max_magnitude:g}"
        return tuple(map(float, self._get(key, lambda v: _are_finite(v, count, max_magnitude), expected)))

    def mapping_or_none(self, key: str) -> Mapping[str, Any] | None:
        """Return the object under `key`, or None if it is null."""
        value: Mapping[str, Any] | None = self._get(
            key, lambda v: v is None or isinstance(v, Mapping), "an object or null"
        )
        return value

    def _get(self, key: str, is_good: Callable[[Any], bool] = lambda value: True, expected: str = "") -> Any:
        """Return the value under `key`; raises ModelError if it is missing or not `expected`."""
        if key not in self.value:
            raise ModelError(f"{self.where}: key '{key}' is missing")
        if not is_good(self.value[key]):
            raise ModelError(f"{self.where}: {key} is {quote(self.value[key])}; expected {expected}")
        return self.value[key]


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write `content` (a string as UTF-8) to a temporary file beside `path` and rename that.

    Raises CesError naming the path if the folder is missing, read-only or full; `path` is then unchanged.
    """
    write_all_atomically({Path(path): content})


def write_all_atomically(files: Mapping[Path, str | bytes]) -> None:
    """Write files that belong together like `write_atomically`: none is renamed before all are written."""
    ready: dict[Path, Path] = {}

    def remove() -> None:
        for temporary in ready.values():
            temporary.unlink(missing_ok=True)

    atexit.register(remove)  # for an end by a signal
    try:
        for path, content in files.items():
            _write_temporary(path, content, ready)
        for path, temporary in ready.items():
            with explain_write_errors(path):
                temporary.replace(path)
    finally:
        remove()
        atexit.unregister(remove)


def _write_temporary(path: Path, content: str | bytes, ready: dict[Path, Path]) -> None:
    """Write a temporary file beside `path`; `ready` names it as soon as it exists."""
    with explain_write_errors(path):
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        ready[path] = Path(temporary)
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode("utf-8") if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        ready[path].chmod(path.stat().st_mode & 0o777 if path.is_file() else 0o644)


@contextmanager
def explain_write_errors(path: Path) -> Iterator[None]:
    """Raise CesError naming `path`, and what to do, for an OSError inside the block."""
    try:
        yield
    except OSError as error:
        full = error.errno in (ENOSPC, EDQUOT)
        advice = "free space there and run the same command" if full else "choose a writable folder"
        raise CesError(f"{path}: cannot be written: {error.strerror}; {advice}") from None


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -1.7e308 < value < 1.7e308


def _are_finite(value: object, count: int, max_magnitude: float) -> bool:
    good = isinstance(value, list) and all(_is_finite(v) and abs(v) <= max_magnitude for v in value)
    return good and len(value) == count  # type: ignore[arg-type]


def quote(value: object) -> str:
    """Return a value as errors quote it: on one line and short."""
    try:
        text = repr(value[:60] if isinstance(value, str) else value)
    except ValueError:  # a whole number of thousands of digits
        text = f"a {type(value).__name__} too large to write"
    return text if len(text) <= 62 else text[:59] + "..."
