"""Seals the answers of a blind test: labels packed against accidental reading and bound by a published hash.

`seal.json` holds a random salt and the packed labels, which contain the hashes of the arrays in `seal/`. The SHA-256 of
salt and labels is published beside the cases: it reveals nothing, and the answers can no longer be changed.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import secrets
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_observer.json_checks import write_atomically
from ces_rig.blind.case_folder import Arrays
from ces_rig.errors import RigError

SCHEMA = "ces-blind/1"
Label = dict[str, Any]


def write_arrays(folder: Path, case: str, arrays: Arrays) -> str:
    """Write `seal/CASE.npz` under `folder` and return its SHA-256."""
    packed = io.BytesIO()
    np.savez_compressed(packed, **arrays)  # type: ignore[arg-type]
    path = _arrays_path(folder, case)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(packed.getvalue())
    return hashlib.sha256(packed.getvalue()).hexdigest()


def write_seal(folder: Path, about: Mapping[str, Any], labels: Sequence[Label]) -> str:
    """Write `seal.json` and `cases/seal.sha256` under `folder` and return the published hash."""
    text = json.dumps({"about": dict(about), "labels": list(labels)}, allow_nan=False)
    packed = base64.b85encode(zlib.compress(text.encode(), 9)).decode()
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    salt = secrets.token_hex(32)
    digest = _digest(salt, packed)
    write_atomically(folder / "seal.json", json.dumps({"schema": SCHEMA, "salt": salt, "labels": packed}) + "\n")
    write_atomically(folder / "cases" / "seal.sha256", f"{digest}\n")
    return digest


def open_seal(folder: Path) -> tuple[Label, list[Label]]:
    """Return the description of the test and its labels; raises RigError if they were changed after sealing."""
    try:
        published = (folder / "cases" / "seal.sha256").read_text(encoding="utf-8").strip()
        sealed = json.loads((folder / "seal.json").read_text(encoding="utf-8"))
        salt, packed = str(sealed["salt"]), str(sealed["labels"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RigError(f"{folder}: not a sealed blind test ({error}); expected one from 'ces blind make'") from None
    if _digest(salt, packed) != published:
        raise RigError(f"{folder}/seal.json: its hash is not the published one in cases/seal.sha256; it was changed")
    content = json.loads(zlib.decompress(base64.b85decode(packed)))
    return content["about"], content["labels"]


def open_arrays(folder: Path, label: Label) -> dict[str, NDArray[np.float64]]:
    """Return the sealed arrays of a case; raises RigError if they are missing or were changed after sealing."""
    path = _arrays_path(folder, label["case"])
    if not path.is_file():
        raise RigError(f"{path}: missing; copy it from the output of 'ces blind make'")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != label["arrays_sha256"]:
        raise RigError(f"{path}: its hash is not the sealed one; it was changed")
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        return {name: arrays[name].astype(np.float64) for name in arrays.files}


def _arrays_path(folder: Path, case: str) -> Path:
    return folder / "seal" / f"{case}.npz"


def _digest(salt: str, packed: str) -> str:
    return hashlib.sha256(f"{salt}\n{packed}".encode()).hexdigest()
