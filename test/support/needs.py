"""What some tests need beyond Python and make: where it is missing, they skip in one line that says what to install.

`@pytest.mark.needs("cc", "nm")` marks a test or, as `pytestmark`, a file; a fixture begins with `skip_without("cc")`.
"""

from __future__ import annotations

import shutil

import pytest

PACKAGES = {  # programs, and the packages of Debian and Ubuntu that have them
    "cc": "gcc",
    "c++": "g++",
    "nm": "binutils",
    "bash": "bash",
    "fish": "fish",
    "zsh": "zsh",
    "Chromium": "chromium (Ubuntu: chromium-browser)",
}


def skip_without(*programs: str) -> None:
    """Skip the test if one of the programs is missing."""
    for program in programs:
        if shutil.which(program) is None:
            skip_missing(program)


def skip_missing(program: str, problem: str = "missing") -> None:
    """Skip the test for want of a program."""
    pytest.skip(f"{program} is {problem}; install it: sudo apt install {PACKAGES[program]}")
