"""The JSON Schemas of the YAML files and gap.json: what each is of, where it lies, and how a file names it.

Editors with a YAML language server (VS Code, Neovim, ...) read that line, complete keys, and underline mistakes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

ABOUT: Mapping[str, str] = {
    "signals": "Signals file: topic and field of each signal (--signals)",
    "import": "Mapping of a log's columns to signals (ces import --mapping)",
    "candidates": "Candidate rules for the terms of a polynomial (ces identify --candidates)",
    "rules": "Rules of a bench (ces characterise --rules)",
    "campaign": "Campaign of identifications (ces identify --campaign)",
    "experiment": "Experiment on the virtual rig (ces rig)",
    "damper": "Damper of the virtual rig, also a simulation (--sim)",
    "iterate": "Plan of an iteration (ces iterate)",
    "observer": "Parameters of the node observer",
    "controller": "Parameters of the node controller",
    "rig-node": "Parameters of the node rig",
    "identify-node": "Parameters of the node identify",
    "gap": "Result of a diagnosis, gap.json (ces diagnose)",
    "calibrated": "Simulation with fitted parameters, calibrated.json (ces calibrate)",
}
KEYWORD = "# yaml-language-server: $schema="


def path_of_schema(name: str) -> Path:
    """Return the file of a schema: one made when the package was built, else the user's, which `ces` makes."""
    built = Path(str(files("ces_identify"))) / "schemas" / f"{name}.json"
    return built if built.is_file() else cache_folder() / "schemas" / built.name


def cache_folder() -> Path:
    """Return the folder in which `ces` keeps what it can make again for a user."""
    cache = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(cache) if cache else Path.home() / ".cache") / "ces_observer"


def schema_line(name: str) -> str:
    """Return the first line of a YAML file that names its schema by an absolute path."""
    return f"{KEYWORD}{path_of_schema(name)}\n"
