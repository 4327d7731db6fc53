"""Files as they are: reports, pictures and tables of ours, each with the type it may have and no other."""

from __future__ import annotations

from pathlib import Path

from flask import Blueprint, Response, abort, send_file

from ces_serve.files.item import REPORT
from ces_serve.files.served_folder import NotServedError
from ces_serve.web.security import FILE_POLICY, POLICY
from ces_serve.web.site import site

TYPES = {  # of files that are served because of what stands beside them
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".csv": "text/csv; charset=utf-8",
    ".md": "text/plain; charset=utf-8",
    ".json": "application/json",
    ".yaml": "text/plain; charset=utf-8",
    ".jsonl": "text/plain; charset=utf-8",
}
OF_FOLDER = {"results.csv", "results.md", "pareto.svg", "pareto.png", "fleet.csv", "plan.yaml", "augmented.json"}
OF_FOLDER |= {"command.csv", "learned.yaml"}

pages = Blueprint("files", __name__)


@pages.get("/files/<path:path>")
def send(path: str) -> Response:
    """Return a file that the lists or pages show; raises 404 for any other."""
    try:
        found = site().folder.find_file(path)
    except NotServedError as error:
        abort(404, str(error))
    kind = _type_of(path, found)
    if kind is None:
        abort(404, f"{path}: not a file that is shown")
    response = send_file(found, mimetype=kind, conditional=False, etag=False, max_age=None)
    response.headers[POLICY] = FILE_POLICY
    return response


def _type_of(path: str, found: Path) -> str | None:
    """Return the type of a file that may be sent, None for others."""
    listing = site().catalogue.listing()
    if listing.find(REPORT, path):
        return "text/html; charset=utf-8"
    listed = {one.path for one in listing.items}
    beside = {one.folder for one in listing.items if one.path != path}
    if path in listed or (found.name in OF_FOLDER and path.rpartition("/")[0] in beside):
        return TYPES.get(found.suffix.lower())
    return None
