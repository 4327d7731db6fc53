"""The application: requests in, pages out. What a page shows of a thing comes from `contents`."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from flask import Blueprint, Flask, Response, abort, current_app, redirect, render_template, request, send_file, url_for
from werkzeug.exceptions import HTTPException
from werkzeug.wrappers import Response as AnyResponse

from ces_identify.comparison.comparison import MAX_DRAWN
from ces_observer import __version__
from ces_observer.errors import CesError
from ces_report.shell import SCRIPTS
from ces_serve import contents
from ces_serve.catalogue import Catalogue, Listing
from ces_serve.folder import NotServedError, ServedFolder
from ces_serve.items import KINDS, MODEL, RECORDING, REPORT, UNREADABLE, WRONG_CONTENT, Item, columns_of
from ces_serve.security import FILE_POLICY, POLICY, protect
from ces_serve.work import Works

MAX_ROWS, MAX_QUERY, MAX_RECORDINGS = 1000, 200, 12
FOLLOW_S = 2  # [s] after which a page that waits or follows asks again
ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16"><path fill="none" stroke="#2a78b8" stroke-width="2.4" '
    'stroke-linecap="round" d="M2 11C5 11 5 4 8 4s3 8 6 8"/></svg>'
)
HTML = "text/html; charset=utf-8"
TYPES = {  # of the files that are sent; no other is
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".csv": "text/csv; charset=utf-8",
    ".json": "application/json",
} | dict.fromkeys((".md", ".yaml", ".jsonl"), "text/plain; charset=utf-8")

pages = Blueprint("pages", __name__)


@dataclass
class Site:
    """The folder that is served, and what is known about it."""

    folder: ServedFolder
    catalogue: Catalogue
    signals: str | None = None
    works: Works = field(default_factory=Works)

    @staticmethod
    def open(path: Path, signals: Path | None = None) -> Site:
        """Return the site of a folder; raises CesError if it is not one."""
        folder = ServedFolder(path)
        return Site(folder, Catalogue(folder), None if signals is None else str(signals))


def make_app(site: Site, host: str) -> Flask:
    """Return the application that shows `site`, to listen on `host`."""
    app = Flask("ces_serve", static_folder=None)
    app.jinja_env.finalize = _replace_half_characters
    app.jinja_env.trim_blocks = app.jinja_env.lstrip_blocks = True
    app.extensions["site"] = site
    protect(app, host)
    app.register_blueprint(pages)
    app.jinja_env.globals.update(
        version=__version__,
        folder_name=site.folder.root.name or "/",
        folder_path=str(site.folder.root),
        names_of=KINDS,
        item_url=contents.item_url,
        describe_search=contents.describe_search,
        max_models=MAX_DRAWN,
        max_recordings=MAX_RECORDINGS,
        follow_s=FOLLOW_S,
    )

    @app.context_processor
    def navigation() -> dict[str, Any]:
        counts = ((kind, heading, len(_listing().of_kind(kind))) for kind, (heading, *_) in KINDS.items() if kind)
        return {"nav_kinds": [row for row in counts if row[2]]}

    @app.errorhandler(HTTPException)
    def problem(error: HTTPException) -> tuple[str, int]:
        code = error.code or 500
        text = "This page failed; the terminal of ces serve has the reason." if code == 500 else error.description
        return render_template("problem.html", title=error.name, kind="", code=code, text=text or ""), code

    return app


@pages.get("/")
def overview() -> str:
    """Return the page of all things, without those that are inside others unless a filter asks for them."""
    return _list_page("")


@pages.get("/list/<kind>")
def list_kind(kind: str) -> str:
    """Return the page of the things of one kind."""
    if not KINDS.get(kind):
        abort(404, f"no kind '{kind}'")
    return _list_page(kind)


@pages.get("/view/<kind>/<path:path>")
def show(kind: str, path: str) -> str:
    """Return the page of a thing; a file that has become unreadable says why."""
    one = _listing().find(kind, path)
    if one is None:
        abort(404, f"{path}: no such {KINDS[kind][1] if kind in KINDS else 'thing'} in this folder")
    content, follows = contents.PageContent(headline=one.problem), False
    try:
        if kind == RECORDING:
            content, follows = _recording_content(one)
        elif kind != UNREADABLE:
            content = contents.content_of(_site().folder, _listing(), one)
    except (CesError, OSError, *WRONG_CONTENT) as error:
        content = contents.PageContent(warnings=[f"cannot be read now: {error}"])
    return render_template(
        "detail.html", title=one.name, kind=kind, names=KINDS[kind], one=one, content=content, follows=follows
    )


@pages.get("/search/<path:path>")
def search(path: str) -> str:
    """Return the page of a running program, which asks again until it ends; of one that has ended, what it wrote."""
    found, content, title = contents.search_content(_site().folder, _site().catalogue, path)
    return render_template("search.html", title=title, kind="", content=content, follows=found)


@pages.get("/compare")
def compare() -> str:
    """Return the page where models and recordings are chosen; those on which all were validated are proposed."""
    listing = _listing()
    models = _chosen(MODEL, "model")
    recordings = listing.of_kind(RECORDING)
    suggested = contents.suggest_recordings(models, recordings, MAX_RECORDINGS)
    return render_template(
        "compare.html",
        title="Compare models",
        kind=MODEL,
        models=models,
        others=[one for one in listing.of_kind(MODEL) if one not in models],
        recordings=sorted(recordings, key=lambda one: one.path not in suggested),
        suggested=suggested,
        uses={one.path: contents.describe_use(one, models) for one in recordings},
    )


@pages.get("/compare/result")
def compare_result() -> AnyResponse | str:
    """Return the page that waits for a comparison, or lead to the finished one."""
    models, bags = _chosen(MODEL, "model"), _chosen(RECORDING, "bag")
    problem = ""
    if not 2 <= len(models) <= MAX_DRAWN:
        problem = f"Models chosen: {len(models)}; choose 2 to {MAX_DRAWN}."
    elif not 1 <= len(bags) <= MAX_RECORDINGS:
        problem = f"Recordings chosen: {len(bags)}; choose 1 to {MAX_RECORDINGS}."
    else:
        try:
            files, recordings = ([_site().folder.find(one.path) for one in chosen] for chosen in (models, bags))
            key = _key_of(*files, *recordings)
        except OSError as error:
            abort(404, str(error))
        task = {"models": [str(path) for path in files], "bags": [str(path) for path in recordings]}
        state = _site().works.ask(key, {**task, "signals": _site().signals})
        if state.result is not None:
            return redirect(url_for("pages.compare_page", key=key))
        problem = state.problem
    back = url_for("pages.compare", model=[one.path for one in models])
    content = contents.PageContent(warnings=[problem] if problem else [], links=[("Choose again", back)])
    content.headline = "" if problem else f"{contents.join_names(models)} on {contents.join_names(bags)}"
    return render_template("search.html", title="Comparing", kind=MODEL, content=content, follows=not problem)


@pages.get("/compare/page/<key>")
def compare_page(key: str) -> Response:
    """Return a page that was computed, as `ces compare` writes it."""
    html = _site().works.find(key)
    if html is None:
        abort(404, "this comparison is no longer kept; compare again")
    return Response(html, mimetype="text/html", headers={POLICY: FILE_POLICY})


@pages.get("/files/<path:path>")
def send(path: str) -> Response:
    """Return a file that the lists or pages show, with the type it may have; raises 404 for any other."""
    try:
        found = _site().folder.find_file(path)
    except NotServedError as error:
        abort(404, str(error))
    listing = _listing()
    listed = {one.path for one in listing.items}
    beside = {one.folder for one in listing.items if one.path != path}
    kind = None
    if listing.find(REPORT, path):
        kind = HTML
    elif path in listed or (found.name in contents.OF_FOLDER and path.rpartition("/")[0] in beside):
        kind = TYPES.get(found.suffix.lower())
    if kind is None:
        abort(404, f"{path}: not a file that is shown")
    response = send_file(found, mimetype=kind, conditional=False, etag=False, max_age=None)
    response.headers[POLICY] = FILE_POLICY
    return response


@pages.get("/assets/<name>")
def asset(name: str) -> Response:
    """Return the icon, the style sheet of reports and this server, or the script of the charts."""
    report, own = resources.files("ces_report"), resources.files("ces_serve")
    if name == "icon.svg":
        return Response(ICON, mimetype="image/svg+xml")
    files = {"style.css": [report / "report.css", own / "templates" / "serve.css"]}
    files["plots.js"] = [report / script for script in SCRIPTS]
    if name not in files:
        abort(404)
    text = "\n".join(file.read_text(encoding="utf-8") for file in files[name])
    return Response(text, mimetype="text/css" if name.endswith("css") else "text/javascript")


def _list_page(kind: str) -> str:
    listing = _listing()
    query = request.args.get("q", "")[:MAX_QUERY]
    candidates = listing.of_kind(kind) if kind else listing.items if query else listing.outermost()
    found = [one for one in candidates if one.matches(tuple(query.lower().split()))]
    return render_template(
        "list.html",
        title=KINDS[kind][0],
        kind=kind,
        query=query,
        items=found[:MAX_ROWS],
        columns=columns_of(kind),
        total=len(candidates),
        found=len(found),
        inside=len(listing.items) - len(candidates) if not kind else 0,
        searches=listing.searches,
        cut=listing.cut,
        problem=listing.problem,
        can_compare=kind == MODEL,
        follows=bool(listing.searches or not listing.items)
        and not query,  # what an empty list waits for is written soon
    )


def _recording_content(one: Item) -> tuple[contents.PageContent, bool]:
    """Return the page of a recording, which is read in another process, and whether it is still being read."""
    found = _site().folder.find(one.path)
    state = _site().works.ask(_key_of(found), {"path": str(found), "signals": _site().signals})
    if state.result is not None:
        return contents.from_json(state.result), False
    if state.problem:
        return contents.PageContent(warnings=[state.problem]), False
    return contents.PageContent("reading the bag …"), True


def _chosen(kind: str, name: str) -> list[Item]:
    """Return the things that the address names, each once and only those that the folder has."""
    paths = dict.fromkeys(request.args.getlist(name)[: 10 * MAX_RECORDINGS])
    return [one for path in paths if (one := _listing().find(kind, path)) is not None]


def _key_of(*paths: Path) -> str:
    """Return a key that changes when one of the files, or of the files in the folders, changes."""
    files = [file for path in paths for file in ([path, *sorted(path.iterdir())] if path.is_dir() else [path])]
    stamps = [(str(file), (state := file.stat()).st_mtime_ns, state.st_size) for file in files]
    return hashlib.sha256(repr((stamps, _site().signals)).encode("utf-8", "replace")).hexdigest()[:24]


def _site() -> Site:
    found: Site = current_app.extensions["site"]
    return found


def _listing() -> Listing:
    return _site().catalogue.listing()


def _replace_half_characters(value: object) -> object:
    """Return a value of a template; a text from JSON may hold halves of characters, which no page can be sent with."""
    if not isinstance(value, str) or value.isascii():
        return value
    return type(value)(value.encode("utf-8", "replace").decode("utf-8"))
