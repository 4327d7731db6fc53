"""Mistakes in the arguments of the launch files are errors of one line, before any node starts."""

from pathlib import Path

import pytest

from ces_observer.errors import CesError
from ces_observer.nodes.launch_arguments import check_files, check_names

LAUNCH = ["ros2", "launch", "ces_observer", "observer.launch.py"]
FILE = "/share/launch/observer.launch.py"
KNOWN = ["model", "namespace"]


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("modle:=a", "unknown launch argument 'modle'; did you mean 'model'\\?"),
        ("rate:=2", "unknown launch argument 'rate'; expected one of model, namespace"),
    ],
)
def test_an_unknown_argument_is_refused(word: str, message: str) -> None:
    with pytest.raises(CesError, match=message):
        check_names(FILE, KNOWN, [*LAUNCH, "model:=m.json", word])


def test_known_arguments_and_those_of_an_including_launch_file_pass() -> None:
    check_names(FILE, KNOWN, [*LAUNCH, "model:=a:=b", "namespace:=car"])
    check_names(FILE, KNOWN, ["ros2", "launch", "car", "car.launch.py", "driver:=me"])


def test_files_must_exist(tmp_path: Path) -> None:
    (tmp_path / "params.yaml").touch()
    check_files({"params_file": str(tmp_path / "params.yaml")})
    with pytest.raises(CesError, match=r"launch argument .params_file.: /nowhere\.yaml: no such file"):
        check_files({"params_file": "/nowhere.yaml"})
