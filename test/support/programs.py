"""The programs as a user calls them, in this process."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import pytest

from ces_cli.main import main


def ces(*words: object) -> int:
    """Run a program; return its exit status."""
    try:
        return main([str(word) for word in words])
    except SystemExit as stop:
        return int(stop.code or 0)


def error_line(capsys: pytest.CaptureFixture[str], *words: object, status: int = 2) -> str:
    """Run a program that must fail with `status`; return its line on standard error, of which there is one.

    Warnings are left out.
    """
    capsys.readouterr()
    assert ces(*words) == status
    printed = capsys.readouterr().err
    lines = [line for line in printed.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1, printed
    assert lines[0].startswith(f"ces {words[0]}"), lines[0]
    return lines[0]


def text_of(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Run a program that must succeed; return what it prints."""
    capsys.readouterr()
    assert ces(*words) == 0
    return capsys.readouterr().out


def document_of(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, Any]:
    """Run a program with --json; return its document."""
    document: dict[str, Any] = json.loads(text_of(capsys, *words, "--json"))
    assert document["schema"] == f"ces-{words[0]}/1"
    return document


def run_here(function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]], *_: int, **__: int) -> Iterator[Any]:
    """Run jobs in this process, in place of `ces_identify.jobs.run_in_processes`, whose own tests start processes."""
    for task in tasks:
        yield function(*task)


# Without the fits of other structures that `ces identify` compares with: `monkeypatch.setattr(*NO_SHORT_FITS)`.
NO_SHORT_FITS = ("ces_identify.structures.auto.physical_structures", tuple)
# With twins of one kind of damper alone, which are fitted in a second: `monkeypatch.setattr(*ONE_KIND)`.
ONE_KIND = ("ces_gap.baseline.twin_fit.KINDS", ("uniflow",))


def only_effects(*names: str) -> tuple[str, Callable[[], tuple[object, ...]]]:
    """Return what makes a diagnosis search among these effects alone: `monkeypatch.setattr(*only_effects(...))`."""
    from ces_gap.effects.library import library

    return "ces_gap.pipeline.library", lambda: tuple(form for form in library() if form.name in names)
