"""Addresses of pages and files for links in contents."""

from __future__ import annotations

from flask import url_for

from ces_serve.files.item import Item
from ces_serve.web.site import Site


def view_url(kind: str, path: str) -> str:
    """Return the address of the page about a thing."""
    return url_for("details.show", kind=kind, path=path)


def files_beside(where: Site, one: Item, names: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return links to those of the named files that are beside a thing."""
    folder = where.folder.root / one.folder
    there = [name for name in names if (folder / name).is_file()]
    return [(name, url_for("files.send", path="/".join(filter(None, (one.folder, name))))) for name in there]
