"""The examples in every program's help: each is parsed by the program's own parser, the quick ones are run.

They run in a folder with the sample recordings, as in the folder of this project.
"""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path

import pytest
from needs import skip_without
from small_recordings import write_small_csv

from ces_cli.main import PROGRAMS, main

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
MORE = {  # options that make an example quick
    "identify": "--time 1 --starts 1 --terms 3 --threads 1 --no-band --candidates rules.yaml",
}
PARSED_ONLY = {  # too slow, or without an end; their own tests run them
    "learn-stroke",
    "iterate",
    "diagnose",
    "blind",
    "serve",
}
RUN = {
    *("info", "signals", "import", "rig", "identify", "validate", "replay", "simulate", "export-data", "export"),
    *("schema", "completion", "characterise", "compare"),
}


def parsers() -> Iterator[tuple[str, argparse.ArgumentParser, argparse.ArgumentParser]]:
    """Yield the name of every program and subprogram with its parser, and the parser of the whole program."""
    for name, (module, _) in PROGRAMS.items():
        whole = import_module(f"ces_cli.{module}").make_parser()
        yield name, whole, whole
        for action in whole._actions:
            if isinstance(action, argparse._SubParsersAction):
                yield from ((f"{name} {part}", own, whole) for part, own in action.choices.items())


def examples(parser: argparse.ArgumentParser) -> list[str]:
    """Return the command lines in a parser's help, without remarks in brackets."""
    lines = [line.strip() for line in (parser.epilog or "").splitlines()]
    return [re.sub(r"\s{2,}\(.*\)$", "", line) for line in lines if line.startswith("ces ")]


EXAMPLES = [(name, line) for name, parser, _ in parsers() for line in examples(parser)]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder with what the examples name, and a home."""
    folder = tmp_path
    for name in ("bags", "config"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "home" / "ros2_ws" / "src").mkdir(parents=True)
    for name in ("model.json", "best.json"):
        shutil.copy(ROOT / "config" / "models" / "sample.json", folder / name)
    shutil.copy(ROOT / "config" / "signals.yaml", folder / "vehicle.yaml")
    (folder / "rules.yaml").write_text("speed: {lags: [0]}\nforce: {lags: [1]}\nproducts: [[speed], [force]]\n")
    write_small_csv(folder / "my_log.csv", seconds=4.0, in_mm=True)
    for seed in (1, 2):
        text = write_small_csv(folder / f"sweep_{seed}.csv", seed, seconds=4.0, in_mm=True).read_text()
        header = "t_s,x_mm,current_A,F_N"  # the columns of config/import/utfsm_mr.yaml
        (folder / f"sweep_{seed}.csv").write_text(text.replace(text.partition("\n")[0], header))
    return folder


def run_line(line: str) -> int:
    """Run a command line with its redirection and wildcards, as a shell would."""
    command, _, file = line.partition(" > ")
    words = shlex.split(command)[1:]
    words += shlex.split(MORE.get(words[0], ""))
    words = [str(Path(word).expanduser()) if word.startswith("~") else word for word in words]
    expanded = [name for word in words for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]
    if not file:
        return main(expanded)
    target = Path(file.strip()).expanduser()
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.open("w") as output, redirect_stdout(output):
        return main(expanded)


def test_every_program_and_subprogram_has_an_example_that_names_it() -> None:
    for name, parser, _ in parsers():
        lines = examples(parser)
        assert lines, name
        assert all(line.startswith(f"ces {name.split()[0]} ") for line in lines), name
        assert any(line.startswith(f"ces {name} ") for line in lines), name


@pytest.mark.parametrize(("name", "line"), EXAMPLES)
def test_examples_are_parsed(name: str, line: str) -> None:
    program, *words = shlex.split(line.partition(" > ")[0])[1:]
    parser = import_module(f"ces_cli.{PROGRAMS[program][0]}").make_parser()
    assert vars(parser.parse_args(words))


@pytest.mark.parametrize(("name", "line"), [(name, line) for name, line in EXAMPLES if name in RUN])
def test_quick_examples_run(name: str, line: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place)
    monkeypatch.setenv("HOME", str(place / "home"))
    monkeypatch.setattr(sys, "argv", ["ces", *line.split()[1:]])
    if "--format fmu" in line:
        skip_without("cc")
    if name == "identify":
        (place / "model.json").unlink()  # its output
    assert run_line(line) == 0


def commands_of(page: Path) -> Iterator[str]:
    """Yield the commands in a page's blocks, without prompt, pipe, output file and optional parts."""
    for block in re.findall(r"^```[a-z]*\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        for line in re.sub(r"\\\n\s*", "", block).splitlines():
            if match := re.match(r"\s*(?:\$ )?ces ([a-z-]+ .*)", re.sub(r"\[.*?\]", "", line)):
                yield re.split(r" [|>] ", match.group(1))[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_the_documents_are_parsed(page: Path) -> None:
    for command in commands_of(page):
        program, *words = shlex.split(command.replace("--seed N ", "--seed 1 "), comments=True)
        options = import_module(f"ces_cli.{PROGRAMS[program][0]}").make_parser().parse_args(words)
        assert vars(options), command


def test_examples_that_do_not_run_are_named() -> None:
    assert set(PROGRAMS) >= PARSED_ONLY | RUN and not PARSED_ONLY & RUN
