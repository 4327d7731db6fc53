"""The compiled core, built from the tick as it is now into a folder of the tests."""

from __future__ import annotations

import subprocess
import sysconfig
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import Any

import pytest
from needs import skip_without

from ces_identify.export.c_printer import C_FLAGS, write_extension

WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror")


def build_core(folder: Path, *flags: str) -> Any:
    """Return the extension `_tick`, compiled with these flags, too; skips without a compiler or Python.h."""
    skip_without("cc")
    headers = sysconfig.get_path("include")
    if not (Path(headers) / "Python.h").exists():
        pytest.skip("Python.h is missing; install it: sudo apt install python3-dev")
    library = folder / f"_tick{sysconfig.get_config_var('EXT_SUFFIX')}"
    sources = write_extension(folder)
    words = ["cc", "-shared", "-fPIC", "-O1", *C_FLAGS, *flags, f"-I{headers}", *sources, "-lm", "-o", str(library)]
    subprocess.run(words, check=True)
    loader = ExtensionFileLoader("_tick", str(library))
    spec = spec_from_loader("_tick", loader)
    assert spec
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module
