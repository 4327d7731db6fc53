"""The application: what the pages share, their routes, and the pages for what cannot be shown."""

from __future__ import annotations

from typing import Any

from flask import Flask, render_template
from werkzeug.exceptions import HTTPException

from ces_observer import __version__
from ces_serve.files.item import KINDS
from ces_serve.web import assets, compare, details, files, lists, observer, searches
from ces_serve.web.columns import format_time
from ces_serve.web.events import SERVER_ERROR, Streams
from ces_serve.web.security import protect
from ces_serve.web.site import Site

ROOMS = (assets.pages, lists.pages, details.pages, files.pages, searches.pages, compare.pages, observer.pages)


def make_app(site: Site, host: str) -> Flask:
    """Return the application that shows `site`, to listen on `host`."""
    app = Flask("ces_serve.web")
    app.jinja_env.finalize = _replace_half_characters
    app.jinja_env.trim_blocks = app.jinja_env.lstrip_blocks = True
    app.extensions["site"], app.extensions["streams"] = site, Streams()
    protect(app, host)
    for room in ROOMS:
        app.register_blueprint(room)
    app.jinja_env.globals.update(
        version=__version__,
        folder_name=site.folder.root.name or "/",
        folder_path=str(site.folder.root),
        names_of=KINDS,
        format_time=format_time,
        item_url=lists.item_url,
        search_url=lists.search_url,
        describe_search=searches.describe_search,
    )

    @app.context_processor
    def navigation() -> dict[str, Any]:
        return {"nav_kinds": lists.count_kinds(site.catalogue.listing())}

    @app.errorhandler(HTTPException)
    def problem(error: HTTPException) -> tuple[str, int]:
        code = error.code or 500
        text = SERVER_ERROR if code == 500 else error.description or ""
        return render_template("problem.html", title=error.name, kind="", code=code, text=text), code

    return app


def _replace_half_characters(value: object) -> object:
    """Return a value of a template; a text from JSON may hold halves of characters, which no page can be sent with."""
    if not isinstance(value, str) or value.isascii():
        return value
    return type(value)(value.encode("utf-8", "replace").decode("utf-8"))
