"""The seal: what was put in comes out, nothing can be read by accident, and any change is refused."""

import json

import numpy as np
import pytest

from ces_rig.blind.cases import open_arrays, open_seal, write_arrays, write_seal
from ces_rig.errors import RigError


@pytest.fixture
def sealed(tmp_path):
    arrays = {"h1_force_N": np.linspace(0.0, 1.0, 5, dtype=np.float32)}
    label = {"case": "0001", "kind": "effect", "effects": [{"name": "friction"}]}
    label["arrays_sha256"] = write_arrays(tmp_path, "0001", arrays)
    digest = write_seal(tmp_path, {"seed": 4}, [label])
    return tmp_path, label, digest


def test_round_trip(sealed):
    folder, label, digest = sealed
    assert open_seal(folder) == ({"seed": 4}, [label])
    assert open_arrays(folder, label)["h1_force_N"] == pytest.approx(np.linspace(0.0, 1.0, 5))
    assert (folder / "cases" / "seal.sha256").read_text().strip() == digest


def test_labels_cannot_be_read_by_accident(sealed):
    text = (sealed[0] / "seal.json").read_text()
    assert "friction" not in text
    assert "effect" not in text


def test_the_same_labels_get_another_hash_each_time(sealed, tmp_path_factory):
    _, label, digest = sealed
    assert write_seal(tmp_path_factory.mktemp("again"), {"seed": 4}, [label]) != digest


def test_other_labels_are_refused(sealed, tmp_path_factory):
    folder, label, _ = sealed
    other = tmp_path_factory.mktemp("other")
    write_seal(other, {"seed": 4}, [{**label, "kind": "none"}])
    (folder / "seal.json").write_text((other / "seal.json").read_text())
    with pytest.raises(RigError, match="its hash is not the published one"):
        open_seal(folder)


def test_other_arrays_are_refused(sealed):
    folder, label, _ = sealed
    write_arrays(folder, "0001", {"h1_force_N": np.zeros(5, np.float32)})
    with pytest.raises(RigError, match=r"0001\.npz: its hash is not the sealed one"):
        open_arrays(folder, label)


@pytest.mark.parametrize("text", ["", "{}", "[1]", json.dumps({"salt": "a"})])
def test_what_is_no_seal_is_refused_in_one_line(sealed, text):
    (sealed[0] / "seal.json").write_text(text)
    with pytest.raises(RigError, match="not a sealed blind test"):
        open_seal(sealed[0])
