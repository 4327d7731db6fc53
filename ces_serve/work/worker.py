"""The process behind `do_work`: one line of JSON in, lines of JSON out; warnings go to standard error.

It ends when its standard input closes, as happens when the server is gone. Memory and files are limited: a small file
may unpack to any size.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any

from ces_observer.errors import CesError

Report = Callable[[str], None]
MAX_MEMORY_BYTES = 8 << 30  # of address space
MAX_FILE_BYTES = 8 << 30  # of a decompressed copy


def main() -> int:
    """Do the task on standard input; returns 0, or 1 if it failed."""
    _limit_this_process()
    stream = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    task = json.loads(_read_line())
    threading.Thread(target=_exit_with_server, daemon=True).start()

    def send(message: Mapping[str, Any]) -> None:
        stream.write(json.dumps(message, allow_nan=False) + "\n")
        stream.flush()

    try:
        send({"result": _do(task, lambda text: send({"progress": text}))})
    except (CesError, OSError) as error:
        send({"failed": str(error)})
        return 1
    except MemoryError:
        send({"failed": "not enough memory"})
        return 1
    return 0


def _limit_this_process() -> None:
    for kind, limit in (
        (resource.RLIMIT_AS, MAX_MEMORY_BYTES),
        (resource.RLIMIT_FSIZE, MAX_FILE_BYTES),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        value = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (value, value))


def _do(task: Mapping[str, Any], report: Report) -> Any:
    match task["name"]:
        case "inspect":
            from ces_serve.work.inspection import inspect_recording

            return inspect_recording(task["path"], task["signals"], report)
        case "compare":
            from ces_serve.work.comparison import compare_files

            return compare_files(task["models"], task["bags"], task["signals"], report)
    raise CesError(f"unknown task {task['name']!r}")


def _read_line() -> bytes:
    """Return the first line of standard input, without a buffer that would hide its end."""
    line = b""
    while not line.endswith(b"\n"):
        part = os.read(sys.stdin.fileno(), 65536)
        if not part:
            raise SystemExit(1)
        line += part
    return line


def _exit_with_server() -> None:
    os.read(sys.stdin.fileno(), 1)
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
