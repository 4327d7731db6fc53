"""Shell completion, tried in the shells themselves."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from needs import skip_without
from patience import PATIENCE_S

from ces_cli.completion import KINDS, SHELLS, build_whole_parser, completion_script, find_kind
from ces_cli.main import PROGRAMS
from ces_cli.terminal.options import list_actions

BASH = """
source ces.bash
COMP_WORDS=({words}); COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 ))
_shtab_ces
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
FISH = "source ces.fish; complete -C {line}"
ZSH_SETUP = """
PS1=; fpath=($PWD $fpath); autoload -Uz compinit; compinit -u -D
compadd() {
  if [[ ${@[1,(i)(-|--)]} != *-(O|A|D)\\ * ]]; then
    local -a hits; builtin compadd -A hits "$@"; (( $#hits )) && print -rl -- $hits >> hits
  fi
  builtin compadd "$@"
}
finish() { : > finished }; zle -N finish; bindkey '^X' finish; bindkey '^I' complete-word
: > ready
"""
ZSH = """
rm -f ready hits finished; touch hits
zmodload zsh/zpty
wait_for() {{ repeat 30000; do [[ -e $1 ]] && return; zpty -rt shell _; sleep 0.005; done }}
zpty -b shell zsh -f -i
zpty -w shell 'source setup.zsh'; wait_for ready
zpty -w -n shell $'{line}\t\x18'; wait_for finished
zpty -d shell
cat hits; rm -f ready hits finished
"""
CASES = [  # words, the last to be completed; what is offered, and what is not
    (["i"], {"info", "import", "identify", "iterate"}, {"rig"}),
    (["identify", "--st"], {"--structure", "--starts"}, {"--seed"}),
    (["identify", "--structure", ""], {"polynomial", "hydraulic", "auto"}, {"a.yaml"}),
    (["identify", "--signals", ""], {"a.yaml"}, {"one.mcap", "model.json"}),
    (["info", ""], {"one.mcap", "two.db3", "folder"}, {"model.json", "a.yaml"}),
    (["validate", "model.json", "folder", "--rep"], {"--report"}, {"--part"}),
    (["identify", "folder", "--validate", "one.mcap", "--rep"], {"--report"}, {"one.mcap"}),
    (["simulate", "--sim", ""], {"model.json", "a.yaml", "b.fmu"}, {"one.mcap"}),
    (["blind", ""], {"make", "run", "score"}, {"one.mcap"}),
    (["blind", "run", "--simul"], {"--simulation"}, {"--seed"}),
    (["help", "le"], {"learn-stroke"}, {"rig"}),
    (["schema", "sig"], {"signals"}, {"campaign"}),
    (["rig", ""], {"a.yaml"}, {"model.json", "one.mcap"}),
    (["rig", "sweep", "--se"], {"--seed"}, {"--signals"}),
]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("completion")
    for name in ("one.mcap", "two.db3", "a.yaml", "model.json", "b.fmu", "notes.txt"):
        (folder / name).touch()
    (folder / "folder").mkdir()
    (folder / "setup.zsh").write_text(ZSH_SETUP)
    for shell, name in (("bash", "ces.bash"), ("fish", "ces.fish"), ("zsh", "_ces")):
        (folder / name).write_text(completion_script(shell))
    return folder


def ask(place: Path, shell: str, code: str) -> set[str]:
    """Return what a shell offers, each without its description and without the slash of a folder."""
    skip_without(shell)
    words = [shell, "-f", "-c", code] if shell == "zsh" else [shell, "-c", code]
    home = {"HOME": str(place), "PATH": "/usr/bin:/bin", "TERM": "vt100"}
    done = subprocess.run(words, cwd=place, env=home, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    assert not done.stderr
    return {word.strip().removesuffix("/") for line in done.stdout.splitlines() for word in line.split("\t")[:1]}


@pytest.mark.parametrize(("words", "offered", "others"), CASES)
def test_bash(place: Path, words: list[str], offered: set[str], others: set[str]) -> None:
    found = ask(place, "bash", BASH.format(words=" ".join(repr(word) for word in ["ces", *words])))
    assert offered <= found and not others & found


@pytest.mark.parametrize(("words", "offered", "others"), CASES)
def test_fish(place: Path, words: list[str], offered: set[str], others: set[str]) -> None:
    found = ask(place, "fish", FISH.format(line=repr(" ".join(["ces", *words]))))
    assert offered <= found and not others & found


@pytest.mark.parametrize(("words", "offered", "others"), [*CASES[2:7], *CASES[-3:]])
def test_zsh(place: Path, words: list[str], offered: set[str], others: set[str]) -> None:
    found = ask(place, "zsh", ZSH.format(line=" ".join(["ces", *words])))
    assert offered <= found and not others & found


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_names_every_program_and_runs_none_of_them(shell: str) -> None:
    script = completion_script(shell)
    assert all(name in script for name in PROGRAMS)
    assert "$(ces" not in script and "python" not in script


def test_every_path_is_completed_by_a_file_name() -> None:
    actions = list(list_actions(build_whole_parser(PROGRAMS)))
    assert all(find_kind(action) is not None for action in actions if action.type is Path)


def test_the_kinds_are_those_of_existing_options() -> None:
    actions = list(list_actions(build_whole_parser(PROGRAMS)))
    assert set(KINDS) <= {str(name) for action in actions for name in (*action.option_strings, action.metavar)}
