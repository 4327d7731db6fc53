"""The documents say what is: their commands and examples run, their links and pictures exist, their size is a decision.

`support/doc_pages.py` explains how a page is run, and which files its commands may name.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import re
import shlex
import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from doc_pages import QUICK_EFFECTS, ROOT, PageRunner, in_folder, make_parser, make_standard_files
from programs import NO_SHORT_FITS, run_here

import ces
import ces_gap.pipeline
from bench.reference.__main__ import NOTE
from bench.reference.__main__ import PAGES as REFERENCE
from bench.write_tables import find_tables
from ces_cli.main import PROGRAMS
from ces_gap.effects.library import library_effect

DOCS = ROOT / "docs"
PAGES = {path.relative_to(ROOT).as_posix(): path for path in (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))}
LINKED = {"CHANGELOG.md": ROOT / "CHANGELOG.md", "bags/README.md": ROOT / "bags/README.md", **PAGES}
MAX_WORDS = 36_000  # of README, CHANGELOG and docs, as `wc -w` counts them
FOLDERS = ("bench", "config", "examples", "launch", "test")
SOURCES = ("*.py", "*.yaml", "*.j2", "*.xml", "*.ipynb")
FENCED = re.compile(r"^( *)```.*?^\1```", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="session")
def standard_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of files that pages may name, made once by whichever process comes first."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    folder = shared / "standard_files"
    with (shared / "standard_files.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            made = shared / "standard_files.new"
            made.mkdir()
            with pytest.MonkeyPatch.context() as patch, in_folder(made):
                shorten(patch)
                make_standard_files(made)
            made.rename(folder)
    return folder


@pytest.fixture
def runner(standard_files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PageRunner:
    """A page's folder, with short searches in it."""
    folder = tmp_path / "page"
    shutil.copytree(standard_files, folder)
    for name in ("config", "examples"):
        (folder / name).symlink_to(ROOT / name)
    shorten(monkeypatch)
    return PageRunner(folder)


def shorten(patch: pytest.MonkeyPatch) -> None:
    """Let examples in Python search for a second, fits of other structures be left out, diagnoses fit two effects."""
    effects = tuple(library_effect(*one) for one in QUICK_EFFECTS)
    patch.setattr(ces_gap.pipeline, "library", lambda: effects)
    identify = ces.identify

    def identify_quickly(*recordings: Any, **options: Any) -> Any:
        if options.get("structure", "auto") == "auto":
            options |= {"structure": "polynomial", "terms": 3}
        return identify(*recordings, **{**options, "time": 1.0, "starts": 1, "band": False})

    patch.setattr(ces, "identify", identify_quickly)
    patch.setattr("ces_identify.jobs.run_in_processes", run_here)
    patch.setattr(*NO_SHORT_FITS)
    patch.setenv("MPLBACKEND", "Agg")


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.slow
def test_commands_and_examples_of_a_page_run(name: str, runner: PageRunner) -> None:
    runner.run(PAGES[name].read_text(encoding="utf-8"))


def parsers() -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield the name of every program and subprogram with its parser."""
    for name in PROGRAMS:
        whole = make_parser(name)
        yield name, whole
        for action in whole._actions:
            if isinstance(action, argparse._SubParsersAction):
                yield from ((f"{name} {part}", own) for part, own in action.choices.items())


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.slow
def test_examples_in_the_help_of_a_program_run(name: str, runner: PageRunner) -> None:
    for program, parser in parsers():
        if program.split()[0] == name:
            lines = [line.strip() for line in (parser.epilog or "").splitlines()]
            lines = [re.sub(r"\s{2,}\(.*\)$", "", line) for line in lines if line.startswith("ces ")]
            assert any(line.startswith(f"ces {program} ") for line in lines), f"no example of ces {program}"
            for line in lines:
                runner.run(f"```console\n$ {line}\n```\n")


def test_links_lead_to_files_and_headings() -> None:
    headings = {path: find_headings(path.read_text(encoding="utf-8")) for path in LINKED.values()}
    broken = []
    for name, path in LINKED.items():
        text = FENCED.sub("", path.read_text(encoding="utf-8"))
        targets = re.findall(r"\]\(([^)\s]+)[^)]*\)|(?:src|href)=\"([^\"]+)\"", text)
        for target in (one or other for one, other in targets):
            file, _, anchor = target.partition("#")
            if re.match(r"\w+:", target):
                continue
            there = (path.parent / file).resolve() if file else path
            if not there.exists() or (anchor and anchor not in headings.get(there, ())):
                broken.append(f"{name}: {target}")
    assert not broken


def find_headings(page: str) -> set[str]:
    """Return the anchors of a page that its site and a repository's host both make."""
    anchors: Counter[str] = Counter()
    for heading in re.findall(r"^#{1,6} +(.*?)#*$", FENCED.sub("", page), re.MULTILINE):
        plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").replace("*", "")
        anchors[re.sub(r"[-\s]", "-", re.sub(r"[^\w\s-]", "", plain).strip().lower())] += 1
    return {anchor for anchor, count in anchors.items() if count == 1}


def test_every_page_is_in_the_navigation_once() -> None:
    named = re.findall(r"([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(named) == sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))


@pytest.mark.parametrize("name", REFERENCE)
@pytest.mark.slow
def test_the_reference_is_that_of_the_declarations(name: str) -> None:
    page = (DOCS / "reference" / f"{name}.md").read_text(encoding="utf-8")
    assert page.strip() == f"{NOTE}{REFERENCE[name]()}".strip(), "run `make reference`"


def test_every_picture_is_shown_and_made_by_a_command() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in LINKED.values())
    drawn = (ROOT / "bench" / "pictures.py").read_text(encoding="utf-8")
    for path in sorted((DOCS / "img").glob("*.*")):
        assert f"img/{path.name})" in text, f"no page shows {path.name}"
        assert path.stat().st_size < 100_000, f"{path.name} is large: fewer colours"
        assert f'"{path.stem}"' in drawn or f"<!-- img/{path.name}: " in text, f"no command makes {path.name}"


def test_tables_of_figures_name_a_command_that_writes_them() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in PAGES.values())
    assert sorted(re.findall(r"^<!-- (.*) table: end -->$", text, re.MULTILINE)) == sorted(find_tables())
    assert len(re.findall(r" table: begin", text)) == len(find_tables()), (
        "a marker is not <!-- NAME table: begin (COMMAND) -->"
    )
    for name, table in find_tables().items():
        python, *words = shlex.split(table.command)
        path = ROOT / (f"{words[1].replace('.', '/')}.py" if words[0] == "-m" else words[0])
        path = path if path.is_file() else path.with_suffix("") / "__main__.py"
        assert python in ("python", "python3") and path.is_file(), name
        source = path.read_text(encoding="utf-8")
        assert all(f'"{word}"' in source for word in words if word.startswith("--")), name


def test_pages_named_in_programs_and_files_exist() -> None:
    folders = [path for path in ROOT.iterdir() if path.name.startswith("ces_") or path.name in FOLDERS]
    files = [path for folder in folders for pattern in SOURCES for path in folder.rglob(pattern)]
    for path in (*files, ROOT / "Makefile", ROOT / "setup.py"):
        for page in re.findall(r"\bdocs/[\w/-]+\.md", path.read_text(encoding="utf-8")):
            assert (ROOT / page).is_file(), f"{path.relative_to(ROOT)} names {page}"


def test_the_documents_stay_short() -> None:
    paths = [ROOT / "README.md", ROOT / "CHANGELOG.md", *DOCS.rglob("*.md")]
    words = sum(len(path.read_text(encoding="utf-8").split()) for path in paths)
    assert words <= MAX_WORDS, f"{words} words: cut, or raise MAX_WORDS and say why"
