"""The style sheet and the script of the charts, which the reports hold inline, as files of this server."""

from __future__ import annotations

from importlib import resources

from flask import Blueprint, Response

from ces_identify.report.shell import SCRIPTS

ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16"><path fill="none" stroke="#2a78b8" stroke-width="2.4" '
    'stroke-linecap="round" d="M2 11C5 11 5 4 8 4s3 8 6 8"/></svg>'
)

pages = Blueprint("assets", __name__)


@pages.get("/assets/style.css")
def style() -> Response:
    """Return the reports' style sheet with this server's after it."""
    common = resources.files("ces_identify.report").joinpath("report.css").read_text(encoding="utf-8")
    own = resources.files("ces_serve.web").joinpath("static", "serve.css").read_text(encoding="utf-8")
    return Response(f"{common}\n{own}", mimetype="text/css")


@pages.get("/assets/plots.js")
def plots() -> Response:
    """Return the script of charts, values of figures and sortable tables."""
    folder = resources.files("ces_identify.report")
    texts = (folder.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS)
    return Response("\n".join(texts), mimetype="text/javascript")


@pages.get("/assets/icon.svg")
def icon() -> Response:
    """Return the icon."""
    return Response(ICON, mimetype="image/svg+xml")
