"""Shell completion, tried in bash, whose script of shtab is changed; those of zsh and fish are as shtab writes them."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from needs import skip_without
from patience import PATIENCE_S

from ces_cli.completion import SHELLS, completion_script
from ces_cli.main import PROGRAMS

BASH = """
source ces.bash
COMP_WORDS=({words}); COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 ))
_shtab_ces
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
CASES = [  # words, the last to be completed; what is offered, and what is not
    (["i"], {"info", "import", "identify", "iterate"}, {"rig"}),
    (["identify", "--st"], {"--structure", "--starts"}, {"--seed"}),
    (["identify", "--structure", ""], {"polynomial", "hydraulic", "auto"}, {"a.yaml"}),
    (["identify", "--signals", ""], {"a.yaml"}, {"polynomial"}),
    (["info", ""], {"one.mcap", "two.db3", "folder"}, {"polynomial"}),
    (["validate", "model.json", "folder", "--rep"], {"--report"}, {"--part"}),
    (["identify", "folder", "--validate", "one.mcap", "--rep"], {"--report"}, {"one.mcap"}),
    (["simulate", "--sim", ""], {"model.json", "a.yaml", "b.fmu"}, {"polynomial"}),
    (["blind", ""], {"make", "run", "score"}, {"one.mcap"}),
    (["blind", "run", "--simul"], {"--simulation"}, {"--seed"}),
    (["help", "ite"], {"iterate"}, {"rig"}),
    (["schema", "sig"], {"signals"}, {"campaign"}),
    (["rig", ""], {"a.yaml"}, {"polynomial"}),
    (["rig", "sweep", "--se"], {"--seed"}, {"--signals"}),
]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("completion")
    for name in ("one.mcap", "two.db3", "a.yaml", "model.json", "b.fmu", "notes.txt"):
        (folder / name).touch()
    (folder / "folder").mkdir()
    (folder / "ces.bash").write_text(completion_script("bash"))
    return folder


@pytest.mark.parametrize(("words", "offered", "others"), CASES)
def test_bash(place: Path, words: list[str], offered: set[str], others: set[str]) -> None:
    skip_without("bash")
    code = BASH.format(words=" ".join(repr(word) for word in ["ces", *words]))
    home = {"HOME": str(place), "PATH": "/usr/bin:/bin", "TERM": "vt100"}
    done = subprocess.run(
        ["bash", "-c", code], cwd=place, env=home, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert not done.stderr
    found = set(done.stdout.split("\n"))
    assert offered <= found and not others & found


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_names_every_program_and_runs_none_of_them(shell: str) -> None:
    script = completion_script(shell)
    assert all(name in script for name in PROGRAMS)
    assert "$(ces" not in script and "python" not in script
