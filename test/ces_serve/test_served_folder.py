"""Only what is in the folder is served: no way out by dots, links, or hidden names."""

from __future__ import annotations

from pathlib import Path

import pytest

from ces_observer.errors import CesError
from ces_serve.catalogue import NotServedError, ServedFolder


@pytest.fixture
def folder(tmp_path: Path) -> ServedFolder:
    root = tmp_path / "root"
    (root / "sub").mkdir(parents=True)
    (root / "sub" / "a b.json").write_text("{}")
    (root / ".hidden").write_text("")
    (tmp_path / "secret").write_text("secret")
    (root / "inside").symlink_to(root / "sub")
    (root / "outside").symlink_to(tmp_path)
    (root / "secret").symlink_to(tmp_path / "secret")
    return ServedFolder(root)


def test_what_is_inside_is_found(folder: ServedFolder) -> None:
    assert folder.find_file("sub/a b.json").read_text() == "{}"
    assert folder.find_file("inside/a b.json").read_text() == "{}"


WAYS_OUT = (
    "../secret", "sub/../../secret", "/etc/passwd", "//etc/passwd", "secret", "outside/secret", ".hidden", "..",
    "sub/./../../secret", "", "sub\\..\\..\\secret", "sub/\0", "x" * 5000, "missing", "sub/..%2f..%2fsecret",
)  # fmt: skip


@pytest.mark.parametrize("path", WAYS_OUT)
def test_there_is_no_way_out(folder: ServedFolder, path: str) -> None:
    with pytest.raises(NotServedError):
        folder.find(path)


def test_a_folder_is_not_a_file(folder: ServedFolder) -> None:
    with pytest.raises(NotServedError, match="not a file"):
        folder.find_file("sub")


def test_only_a_folder_can_be_served(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CesError, match="is not a folder; expected the folder to show"):
        ServedFolder(tmp_path / "file")
    with pytest.raises(CesError, match="no such folder"):
        ServedFolder(tmp_path / "missing")
