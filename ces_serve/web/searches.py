"""The page of a program that is running: what its progress file says, and how it goes on, as events."""

from __future__ import annotations

import socket
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from flask import Blueprint, Response, render_template, url_for

from ces_identify.progress_file import RUNNING, RunProgress, progress_path, read_progress
from ces_observer.errors import CesError
from ces_serve.files.facts import WRONG_CONTENT
from ces_serve.files.item import CAMPAIGN, REPORT, Item
from ces_serve.files.listing import RunningSearch
from ces_serve.files.served_folder import NotServedError
from ces_serve.web import curves
from ces_serve.web.campaign_content import campaign_content
from ces_serve.web.events import ALIVE, Events, streams
from ces_serve.web.site import Site, site
from ces_serve.web.tables import PageCell, PageContent, PageTable, cell, join, number

POLL_S, REPORT_EVERY = 0.3, 4  # [s] between looks at the file; looks between signs of life

pages = Blueprint("searches", __name__)


@pages.get("/search/<path:path>")
def show(path: str) -> str:
    """Return the page of a running program; of one that has ended, what it wrote."""
    search, left = _find(path), _left_behind(site(), path)
    content = _content_now(site(), path, search.progress) if search else PageContent()
    return render_template(
        "search.html",
        title=path if path != "." else site().folder.root.name,
        kind="",
        running=search is not None,
        content=content,
        outcome=_outcome(site(), path, _began_s(left)),
        killed=left is not None,
        events=url_for("searches.follow", path=path),
        can_compare=False,
    )


@pages.get("/events/search/<path:path>")
def follow(path: str) -> Response:
    """Stream the content of the page whenever the program has written more, until it ends; only its end if it has."""
    search = _find(path)
    return streams().respond(_follow(site(), search) if search else _end(site(), path))


def describe_search(search: RunningSearch) -> str:
    """Return what a running program does, in one line, whatever its progress file holds."""
    try:
        return f"{search.path}: {_describe(search.progress)}"
    except WRONG_CONTENT as error:
        return f"{search.path}: its progress cannot be read: {error}"


def _describe(progress: RunProgress) -> str:
    head, rows = progress.head, progress.rows
    if head.get("program") == "jobs":
        done = rows[-1].get("done") if rows else head.get("done")
        return f"{done} of {head.get('total')} {head.get('things')}"
    costs = [row["cost"] for row in _last_step(progress) if isinstance(row.get("cost"), int | float)]
    best = f"best selection cost J = {min(costs):.2f} %" if costs else "no model yet"
    return f"{_step(progress) or head.get('program')}, {best}"


def _search_content(where: Site, path: str, progress: RunProgress) -> PageContent:
    """Return what a running program has found so far."""
    head = progress.head
    elapsed_s = max(0.0, time.time() - float(head.get("began_s") or time.time()))
    facts = [("program", f"ces {head.get('program')}"), ("running for", number(elapsed_s, ".0f", "s"))]
    if head.get("program") == "jobs":
        return _jobs_content(where, path, progress, facts[1:])
    rows = _last_step(progress)
    content = PageContent(headline=f"{_describe(progress)}.")
    newest = {row["seed"]: row["ended"] for row in rows if "seed" in row}
    ended = [seed for seed, state in newest.items() if state != RUNNING]
    content.facts = [*facts, *_limits(head), ("starts done", _count(len(ended), head.get("starts")))]
    content.charts = curves.search_chart(rows, f"Search for {path}")
    content.tables = _starts(rows)
    return content


def _jobs_content(where: Site, path: str, progress: RunProgress, facts: list[tuple[str, str]]) -> PageContent:
    """Return the content of a campaign or fleet with its results so far."""
    content = PageContent()
    folder = "" if path == "." else path
    campaign = where.catalogue.listing().find(CAMPAIGN, f"{folder}/results.jsonl".lstrip("/"))
    if campaign is not None:
        content = campaign_content(where, campaign)
    done = progress.rows[-1] if progress.rows else {"done": progress.head.get("done"), "failed": 0}
    content.headline = f"{done.get('done')} of {progress.head.get('total')} {progress.head.get('things')} done."
    content.facts = [*facts, ("failed", str(done.get("failed")))]
    content.links = []
    return content


def _follow(where: Site, search: RunningSearch) -> Events:
    before, looks = (-1, -1), 0
    while True:
        now = _size(search.file)
        progress = read_progress(search.file) if now != before or looks % REPORT_EVERY == 0 else None
        if now is None or (progress is not None and not progress.alive):
            yield from _end(where, search.path, search.progress, killed=now is not None)
            return
        if progress is not None:
            yield "content", render_template("content.html", content=_content_now(where, search.path, progress))
        else:
            yield ALIVE
        before, looks = now, looks + 1
        time.sleep(POLL_S)


def _end(where: Site, path: str, progress: RunProgress | None = None, killed: bool = False) -> Events:
    outcome = _outcome(where, path, _began_s(progress))
    yield "ended", render_template("outcome.html", outcome=outcome, killed=killed)


def _content_now(where: Site, path: str, progress: RunProgress) -> PageContent:
    try:
        return _search_content(where, path, progress)
    except (CesError, OSError, *WRONG_CONTENT) as error:
        return PageContent(warnings=[f"cannot be read now: {error}"])


def _outcome(where: Site, path: str, began_s: float) -> list[Item]:
    """Return what a program with this output has written since it began; what is older is of a run before."""
    results = ("results.jsonl", "iterations.jsonl", "fleet.jsonl")
    paths = {path, *(f"{path}/{name}".removeprefix("./") for name in results)}
    found = [one for one in where.catalogue.listing(anew=True).items if one.path in paths and one.kind != REPORT]
    return [one for one in found if one.modified_s >= began_s]


def _began_s(progress: RunProgress | None) -> float:
    """Return when a program of this computer began (Unix time), 0 if that is not known."""
    head = progress.head if progress else {}
    began_s = head.get("began_s")
    return began_s if isinstance(began_s, float) and head.get("host") == socket.gethostname() else 0.0


def _left_behind(where: Site, path: str) -> RunProgress | None:
    """Return what a killed program with this output has left."""
    try:
        return read_progress(progress_path(where.folder.find(path)))
    except NotServedError:
        return None


def _find(path: str) -> RunningSearch | None:
    """Return what runs with this output, as it is now: the list of the folder may be some seconds old."""
    found = next((one for one in site().catalogue.listing().searches if one.path == path), None)
    progress = read_progress(found.file) if found else None
    return replace(found, progress=progress) if found and progress and progress.alive else None


def _size(path: Path) -> tuple[int, int] | None:
    try:
        state = path.stat()
    except OSError:
        return None
    return state.st_mtime_ns, state.st_size


def _last_step(progress: RunProgress) -> list[dict[str, Any]]:
    """Return the rows of the present search."""
    rows = [dict(row) for row in progress.rows]
    begins = [k for k, row in enumerate(rows) if "step" in row]
    return rows[begins[-1] + 1 :] if begins else rows


def _step(progress: RunProgress) -> str:
    """Return the present step of a program with several searches, empty for others."""
    return str(next((row["step"] for row in reversed(progress.rows) if "step" in row), ""))


def _limits(head: Mapping[str, Any]) -> list[tuple[str, str]]:
    known = [("structure", str(head.get("structure") or "")), ("time limit", number(head.get("seconds"), "g", "s"))]
    known += [
        ("identified on", join(head.get("recordings") or ())),
        ("validated on", join(head.get("validation") or ())),
    ]
    return [(name, value) for name, value in known if value not in ("", "–")]


def _count(done: int, total: object) -> str:
    return f"{done} of {total}" if isinstance(total, int) else str(done)


def _starts(rows: list[dict[str, Any]]) -> list[PageTable]:
    """Return the table of the starts, the best first."""
    newest = {row["seed"]: row for row in rows if "seed" in row}
    known = sorted(newest.values(), key=lambda row: (row["cost"] is None, row["cost"] or 0.0))
    cells = tuple(
        (
            cell(row["seed"], "d"),
            cell(row["cost"], ".3f"),
            cell(row["size"], "d"),
            cell(row["elapsed_s"], ".1f"),
            PageCell(str(row["ended"])),
        )
        for row in known
    )
    headings = ("start (seed)", "selection cost J %", "terms or parameters", "at s", "state")
    return [PageTable("Starts, best first", headings, cells)] if cells else []
