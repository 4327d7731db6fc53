"""The overview and the list of each kind: filter, sort order and page come from the URL."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import urlencode

from flask import Blueprint, Response, abort, render_template, request, url_for

from ces_serve.files.item import KINDS, MODEL, REPORT, UNREADABLE, Item
from ces_serve.files.listing import Listing, RunningSearch
from ces_serve.web.columns import ALL, NAME, ListColumn, columns_of, sort_items
from ces_serve.web.events import ALIVE, Events, streams
from ces_serve.web.site import site

PAGE_ROWS = 200
WATCH_S = 1.0
MAX_QUERY = 200

pages = Blueprint("lists", __name__)


@dataclass(frozen=True)
class Heading:
    """A column's heading: a link that sorts by it, and whether the list is sorted so now."""

    column: ListColumn
    url: str
    sorted: str  # for aria-sort


@pages.get("/")
def overview() -> str:
    """Return the page of all things."""
    return _page(ALL, "Overview")


@pages.get("/list/<kind>")
def list_kind(kind: str) -> str:
    """Return the page of the things of one kind."""
    if kind not in KINDS:
        abort(404, f"no kind '{kind}'")
    return _page(kind, KINDS[kind][0])


@pages.get("/events/overview")
def watch() -> Response:
    """Stream the state of the list and of the running searches, first as it is and then whenever it changes.

    A page that shows another state than the first is out of date: what it shows was listed before the stream began.
    """
    return streams().respond(_watch(site().catalogue.listing))


def item_url(one: Item) -> str:
    """Return the address of a thing: a report as it is, the page about anything else."""
    if one.kind == REPORT:
        return url_for("files.send", path=one.path)
    return url_for("details.show", kind=one.kind, path=one.path)


def search_url(search: RunningSearch) -> str:
    """Return the address of a running search."""
    return url_for("searches.show", path=search.path)


def _page(kind: str, title: str) -> str:
    listing = site().catalogue.listing()
    query, order = request.args.get("q", "")[:MAX_QUERY], request.args.get("sort", "")[:40]
    candidates = listing.of_kind(kind) if kind != ALL else listing.items if query else listing.outermost()
    words = tuple(query.lower().split())
    columns = (NAME, *columns_of(kind))
    found = sort_items([one for one in candidates if one.matches(words)], order, columns)
    number = min(max(request.args.get("page", 1, int), 1), max(1, -(-len(found) // PAGE_ROWS)))
    first = (number - 1) * PAGE_ROWS
    return render_template(
        "list.html",
        title=title,
        kind=kind,
        query=query,
        order=order,
        headings=[_heading(column, order, query) for column in columns],
        items=found[first : first + PAGE_ROWS],
        columns=columns[1:],
        total=len(candidates),
        found=len(found),
        first=first,
        older=_url(query, order, number + 1) if first + PAGE_ROWS < len(found) else "",
        newer=_url(query, order, number - 1) if number > 1 else "",
        inside=len(listing.items) - len(candidates) if kind == ALL else 0,
        searches=listing.searches,
        state=_fingerprint(listing),
        cut=listing.cut,
        problem=listing.problem,
        can_compare=kind == MODEL,
        can_link=kind != UNREADABLE,
    )


def count_kinds(listing: Listing) -> list[tuple[str, str, int]]:
    """Return name, heading and number of each kind that there is."""
    counts = [(kind, heading, len(listing.of_kind(kind))) for kind, (heading, *_) in KINDS.items()]
    return [row for row in counts if row[2]]


def _heading(column: ListColumn, order: str, query: str) -> Heading:
    falling = order == f"-{column.key}"
    rising = order == column.key
    following = column.key if falling or not (rising or column.falling) else f"-{column.key}"
    return Heading(column, _url(query, following, 1), "descending" if falling else "ascending" if rising else "none")


def _url(query: str, order: str, page: int) -> str:
    given = {"q": query, "sort": order, "page": page if page > 1 else ""}
    return "?" + urlencode({key: value for key, value in given.items() if value})


def _watch(listing_of: Callable[[], Listing]) -> Events:
    before = ""
    while True:
        now = _fingerprint(listing_of())
        yield ("listed", now) if now != before else ALIVE
        before = now
        time.sleep(WATCH_S)


def _fingerprint(listing: Listing) -> str:
    items = ((one.kind, one.path, one.modified_s, one.problem) for one in listing.items)
    searches = ((search.path, len(search.progress.rows)) for search in listing.searches)
    return f"{hash((tuple(items), tuple(searches), listing.problem)):x}"
