"""The page of one thing: its facts, tables and charts, and links to what belongs to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from flask import Blueprint, Response, abort, render_template, url_for

from ces_observer.errors import CesError
from ces_serve.files import item
from ces_serve.files.facts import WRONG_CONTENT
from ces_serve.files.item import KINDS, RECORDING, REPORT, Item
from ces_serve.files.served_folder import NotServedError
from ces_serve.web import contents
from ces_serve.web.campaign_content import campaign_content
from ces_serve.web.events import Event, Events, streams
from ces_serve.web.lists import item_url
from ces_serve.web.recording_content import recording_content
from ces_serve.web.site import Site, site, stamp
from ces_serve.web.tables import PageContent
from ces_serve.web.work_events import stream_work

INSPECT_LIMIT_S = 120.0
MAX_BESIDE = 12
CONTENTS: dict[str, Callable[[Site, Item], PageContent]] = {
    item.MODEL: contents.model_content,
    item.CAMPAIGN: campaign_content,
    item.DIAGNOSIS: contents.diagnosis_content,
    item.FLEET: contents.fleet_content,
    item.ITERATION: contents.iteration_content,
    item.STROKE: contents.stroke_content,
}

pages = Blueprint("details", __name__)


@pages.get("/view/<kind>/<path:path>")
def show(kind: str, path: str) -> str:
    """Return the page of a thing; a file that has become unreadable says why."""
    one = _find(kind, path)
    content = PageContent(headline=one.problem)
    if kind in CONTENTS:
        try:
            content = CONTENTS[kind](site(), one)
        except (CesError, OSError, *WRONG_CONTENT) as error:
            content = PageContent(warnings=[f"cannot be read now: {error}"])
    return render_template(
        "detail.html",
        title=one.name,
        kind=kind,
        names=KINDS[kind],
        one=one,
        content=content,
        work=url_for("details.inspect", path=path) if kind == RECORDING else "",
        can_compare=any(table.picks for table in content.tables),
        beside=_beside(one, content),
    )


@pages.get("/events/inspect/<path:path>")
def inspect(path: str) -> Response:
    """Stream what a recording holds; it is read in another process, and kept until the bag changes."""
    one = _find(RECORDING, path)
    try:
        found = site().folder.find(one.path)
        key = stamp(found)
    except (NotServedError, OSError) as error:
        abort(404, str(error))
    task = {"name": "inspect", "path": str(found), "signals": site().signals}
    return streams().respond(_inspect(site(), key, task))


def _inspect(where: Site, key: object, task: Mapping[str, object]) -> Events:
    kept = where.inspected.get(key)
    if kept is not None:
        yield "result", kept
        return

    def finish(found: dict[str, Any]) -> Event:
        html = render_template("content.html", content=recording_content(found))
        where.inspected.keep(key, html)
        return "result", html

    yield from stream_work(task, INSPECT_LIMIT_S, where.inspecting, finish)


def _find(kind: str, path: str) -> Item:
    one = site().catalogue.listing().find(kind, path)
    if one is None:
        abort(404, f"{path}: no such {KINDS[kind][1] if kind in KINDS else 'thing'} in this folder")
    return one


def _beside(one: Item, content: PageContent) -> list[tuple[str, str, str]]:
    """Return name, address and kind of what is in the same folder and has no link yet, at most a dozen."""
    linked = {address for _, address in content.links}
    found = [
        other for other in site().catalogue.listing().items if other.folder == one.folder and other.path != one.path
    ]
    rows = [(o.label, item_url(o), KINDS[o.kind][1]) for o in found if o.kind in (REPORT, *CONTENTS)]
    return [row for row in rows if row[1] not in linked][:MAX_BESIDE]
