"""Where compiled code is kept: beside the package or in the home; where neither can be written, for this run only.

Without any such folder Numba ends a program while its modules are imported. This module imports the standard library
only, so that it can run before.
"""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
PACKAGE = Path(__file__).resolve().parents[2] / "ces_identify" / "numerics"


def require_folder_for_compiled_code() -> None:
    """Set NUMBA_CACHE_DIR to a folder of this run if none of the usual folders can be written, with a warning."""
    if any(map(_is_writable, _usual_folders())):
        return
    folder = tempfile.mkdtemp(prefix="ces_observer_")  # private: code is loaded from it
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[VARIABLE] = folder
    text = "compiled code is kept for this run only, because neither the package nor the home can be written"
    print(f"warning: {text}; name a folder in {VARIABLE} to start faster", file=sys.stderr)


def _usual_folders() -> Iterator[Path]:
    if os.environ.get(VARIABLE):
        yield Path(os.environ[VARIABLE])
    yield PACKAGE / "__pycache__"
    yield Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "numba"


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, RuntimeError):  # no home at all
        return False
    return True
