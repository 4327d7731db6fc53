"""The application and its server: requests in, pages out. What a page shows of a thing comes from `contents`.

Every request must be one that reads, for a page of this server in this browser.

The server is Werkzeug's own, a thread for each connection, without its reloader and debugger. Its authors advise
against it for sites on the internet, for want of speed and hardening. Here one person looks at files of this computer.
"""

from __future__ import annotations

import hashlib
import ipaddress
import json
import socket
import threading
from importlib import resources
from pathlib import Path
from typing import Any

from flask import Blueprint, Flask, Response, abort, current_app, render_template, request, send_file, url_for
from werkzeug.exceptions import HTTPException
from werkzeug.serving import WSGIRequestHandler, make_server

from ces_cli.desk import contents
from ces_cli.desk.catalogue import Catalogue, Listing, NotServedError, ServedFolder
from ces_cli.desk.items import KINDS, MODEL, RECORDING, REPORT, UNREADABLE, WRONG_CONTENT, Item, list_facts
from ces_cli.desk.work import Works, WorkState
from ces_identify.comparison.comparison import MAX_DRAWN
from ces_observer import __version__
from ces_observer.errors import CesError
from ces_report.shell import SCRIPTS, replace_unencodable

MAX_ROWS, MAX_QUERY, MAX_RECORDINGS = 1000, 200, 12
EVERYWHERE = ("0.0.0.0", "::")
IDLE_S = 120.0  # [s] after which a silent connection is closed
FOLLOW_S = 2  # [s] after which a page that waits or follows asks again
TYPES = {  # of the files that are sent; no other is
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".csv": "text/csv; charset=utf-8",
    ".json": "application/json",
} | dict.fromkeys((".md", ".yaml", ".jsonl"), "text/plain; charset=utf-8")

ASSETS = {  # by name: the type, and the files one after the other
    "style.css": ("text/css", (("ces_report", "report.css"), ("ces_cli.desk", "templates/serve.css"))),
    "plots.js": ("text/javascript", tuple(("ces_report", name) for name in SCRIPTS)),
}
pages = Blueprint("pages", __name__)


class Site:
    """The folder that is served, and what is known about it; raises CesError if it is not a folder."""

    def __init__(self, path: Path, signals: Path | None = None) -> None:
        self.folder = ServedFolder(path)
        self.catalogue = Catalogue(self.folder)
        self.signals = None if signals is None else str(signals)
        self.works = Works()


def make_app(site: Site, host: str) -> Flask:
    """Return the application that shows `site`, to listen on `host`."""
    app = Flask("ces_cli.desk", static_folder=None)
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
        max_models=MAX_DRAWN,
        max_recordings=MAX_RECORDINGS,
        follow_s=FOLLOW_S,
    )

    @app.errorhandler(HTTPException)
    def problem(error: HTTPException) -> tuple[str, int]:
        code = error.code or 500
        text = "This page failed; the terminal of ces serve has the reason." if code == 500 else error.description
        return _render("problem.html", title=error.name, kind="", code=code, text=text or ""), code

    return app


class QuietHandler(WSGIRequestHandler):
    """Handles requests without a line in the terminal for each; errors are shown."""

    timeout = IDLE_S
    protocol_version = "HTTP/1.1"

    def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
        """Log nothing."""

    def version_string(self) -> str:
        """Return the value of the header Server."""
        return "ces"


class PageServer:
    """A server of one folder at `url`; raises CesError if it cannot listen."""

    def __init__(self, folder: Path, host: str, port: int, signals: Path | None = None) -> None:
        self._site = Site(folder, signals)
        try:  # Werkzeug would end the program if the port is taken, and has a descriptor of its own afterwards
            with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM) as listener:
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listener.bind((host, port))
                listener.listen()
                app, fd = make_app(self._site, host), listener.fileno()
                self._server = make_server(host, port, app, threaded=True, request_handler=QuietHandler, fd=fd)
        except OSError as error:
            reason, remedy = error.strerror or error, "choose another with --port, or 0 for a free one"
            raise CesError(f"cannot listen on {host}, port {port}: {reason}; {remedy}") from None
        name = socket.gethostname() if host in EVERYWHERE else host
        self.url = f"http://{f'[{name}]' if ':' in name else name}:{self._server.port}/"

    def run(self) -> None:
        """Serve until Ctrl-C or `stop`."""
        threading.Thread(target=self._site.catalogue.listing, daemon=True).start()  # before the first page asks for it
        try:
            self._server.serve_forever(poll_interval=0.2)
        finally:
            self._site.works.close()
            self._server.server_close()

    def stop(self) -> None:
        """End `run`, called in another thread."""
        self._server.shutdown()


@pages.get("/")
@pages.get("/list/<kind>")
def overview(kind: str = "") -> str:
    """Return the list of one kind, or of all things without those inside others, which a filter finds."""
    if kind not in KINDS:
        abort(404, f"no kind '{kind}'")
    listing, query = _listing(), request.args.get("q", "")[:MAX_QUERY]
    candidates = listing.of_kind(kind) if kind else listing.items if query else listing.outermost()
    texts = (
        (item, f"{item.kind} {item.path} {item.problem} {list(item.facts.values())}".lower()) for item in candidates
    )
    shown = [item for item, text in texts if all(word in text for word in query.lower().split())]
    return _render(
        "list.html",
        title=KINDS[kind][0],
        kind=kind,
        query=query,
        listing=listing,
        total=len(candidates),
        found=len(shown),
        items=shown[:MAX_ROWS],
        headings=[(heading, is_number) for heading, _, is_number in list_facts(kind, shown[0])] if shown else [],
        groups=contents.group_by_tests(shown[:MAX_ROWS]),
        facts_of=list_facts,
        follows=not listing.items and not query,  # an empty list is filled soon
    )


@pages.get("/view/<kind>/<path:path>")
def show(kind: str, path: str) -> str:
    """Return the page of a thing; a file that has become unreadable says why."""
    item = _listing().find(kind, path)
    if item is None:
        abort(404, f"{path}: no such {KINDS[kind][1] if kind in KINDS else 'thing'} in this folder")
    content, follows = contents.PageContent(headline=item.problem), False
    try:
        if kind == RECORDING:
            state = _ask_for(bags=[item])
            follows = state.result is None and not state.problem
            content = contents.PageContent(
                "reading the bag …" if follows else "", [state.problem][: bool(state.problem)]
            )
            content = content if state.result is None else contents.PageContent(**json.loads(state.result))
        elif kind != UNREADABLE:
            content = contents.content_of(_site().folder, _listing(), item)
    except (CesError, OSError, *WRONG_CONTENT) as error:
        if isinstance(error, WRONG_CONTENT):  # perhaps an error of the program
            current_app.logger.warning("%s", request.path, exc_info=error)
        content = contents.PageContent(warnings=[f"cannot be read now: {error}"])
    return _render("detail.html", title=item.name, kind=kind, item=item, content=content, follows=follows)


@pages.get("/compare")
def compare() -> str:
    """Return the page where models and recordings are chosen; those on which all were validated are proposed."""
    listing = _listing()
    models = _chosen(MODEL, "model")
    recordings = listing.of_kind(RECORDING)
    suggested = contents.suggest_recordings(models, recordings, MAX_RECORDINGS)
    return _render(
        "compare.html",
        title="Compare models",
        kind=MODEL,
        models=models,
        others=[item for item in listing.of_kind(MODEL) if item not in models],
        recordings=sorted(recordings, key=lambda item: item.path not in suggested),
        suggested=suggested,
    )


@pages.get("/compare/result")
def compare_result() -> Response | str:
    """Return the page that waits for a comparison; once it is finished, the page that `ces compare` writes."""
    models, bags = _chosen(MODEL, "model"), _chosen(RECORDING, "bag")
    if not 2 <= len(models) <= MAX_DRAWN:
        problem = f"Models chosen: {len(models)}; choose 2 to {MAX_DRAWN}."
    elif not 1 <= len(bags) <= MAX_RECORDINGS:
        problem = f"Recordings chosen: {len(bags)}; choose 1 to {MAX_RECORDINGS}."
    else:
        try:
            state = _ask_for(models=models, bags=bags)
        except (OSError, NotServedError) as error:
            abort(404, str(error))
        if state.result is not None:
            return Response(state.result, mimetype="text/html", headers={POLICY: FILE_POLICY})
        problem = state.problem
    back = url_for("pages.compare", model=[item.path for item in models])
    content = contents.PageContent(warnings=[problem] if problem else [], links=[("Choose again", back)])
    if not problem:
        content.headline = " on ".join(", ".join(item.path for item in chosen) for chosen in (models, bags))
    return _render("search.html", title="Comparing", kind=MODEL, content=content, follows=not problem)


@pages.get("/files/<path:path>")
def send(path: str) -> Response:
    """Return a file that the lists or pages show, with the type it may have; raises 404 for any other."""
    try:
        file = _site().folder.find_file(path)
    except NotServedError as error:
        abort(404, str(error))
    items, kind = _listing().items, None
    is_beside = any(item.folder == path.rpartition("/")[0] and item.path != path for item in items)
    if any(item.path == path for item in items) or (is_beside and file.name in contents.OF_FOLDER):
        kind = "text/html; charset=utf-8" if _listing().find(REPORT, path) else TYPES.get(file.suffix.lower())
    if kind is None:
        abort(404, f"{path}: not a file that is shown")
    response = send_file(file, mimetype=kind, conditional=False, etag=False, max_age=None)
    response.headers[POLICY] = FILE_POLICY
    return response


@pages.get("/assets/<name>")
def asset(name: str) -> Response:
    """Return the style sheet of reports and this server, or the script of the charts."""
    if name not in ASSETS:
        abort(404)
    kind, files = ASSETS[name]
    text = "\n".join(resources.files(package).joinpath(file).read_text(encoding="utf-8") for package, file in files)
    return Response(text, mimetype=kind)


def _chosen(kind: str, name: str) -> list[Item]:
    """Return the things that the address names, each once and only those that the folder has."""
    paths = dict.fromkeys(request.args.getlist(name)[: 10 * MAX_RECORDINGS])
    return [item for path in paths if (item := _listing().find(kind, path)) is not None]


def _ask_for(**things: list[Item]) -> WorkState:
    """Return the state of the work on files and folders; it is done again when one of them has changed."""
    task: dict[str, Any] = {}
    stamps: list[tuple[str, int, int]] = []
    for name, chosen in things.items():
        paths = [_site().folder.find(item.path) for item in chosen]
        task[name] = [str(path) for path in paths]
        files = [file for path in paths for file in ([path, *sorted(path.iterdir())] if path.is_dir() else [path])]
        stamps += [(str(file), (state := file.stat()).st_mtime_ns, state.st_size) for file in files]
    key = hashlib.sha256(repr((stamps, _site().signals)).encode("utf-8", "replace")).hexdigest()[:24]
    return _site().works.ask(key, {**task, "signals": _site().signals})


def _site() -> Site:
    site: Site = current_app.extensions["site"]
    return site


def _listing() -> Listing:
    return _site().catalogue.listing()


def _render(template: str, **values: Any) -> str:
    """Return a page; texts from JSON may hold halves of characters, which no page can be sent with."""
    counts = ((kind, heading, len(_listing().of_kind(kind))) for kind, (heading, *_) in KINDS.items() if kind)
    return replace_unencodable(render_template(template, nav_kinds=[row for row in counts if row[2]], **values))


POLICY = "Content-Security-Policy"
HEADERS = {
    POLICY: "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
# Pages from the folder: their own scripts and styles, as in the file, in an origin of their own, and no connections.
FILE_POLICY = (
    "sandbox allow-scripts allow-modals; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; font-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def protect(app: Flask, host: str) -> None:
    """Check all requests to `app`, which listens on `host`, and complete the headers of its responses."""

    @app.before_request
    def check() -> Response | None:
        from_other_site = request.headers.get("Sec-Fetch-Site") in ("cross-site", "same-site")
        if request.method not in ("GET", "HEAD"):
            status, reason = 405, "this server only shows; it takes GET and HEAD"
        elif not is_own_name(request.host, host):
            status, reason = 421, "unknown Host; open the address that ces serve has printed"
        elif from_other_site and request.headers.get("Sec-Fetch-Mode") != "navigate":
            status, reason = 403, "requests from other sites are refused"
        else:
            return None
        # without the frame of the pages, which names the folder: who asks may be another site
        return Response(f"{reason}\n", status, mimetype="text/plain")

    @app.after_request
    def complete(response: Response) -> Response:
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)
        return response


def is_own_name(host_header: str, bound: str) -> bool:
    """Return whether a Host header names this server, bound to `bound`.

    A page of another site that makes its own name point here (DNS rebinding) sends that name. On loopback only its
    names are right, with any port, which a tunnel may change; on another address also this computer's name, and all
    addresses, which are no names.
    """
    bracketed = host_header.startswith("[")
    name = (host_header[1:].partition("]") if bracketed else host_header.partition(":"))[0].lower()
    own, shared = socket.gethostname().lower(), not is_loopback(bound)
    address = _parse_address(name)
    if address is not None and (shared or address.is_loopback):
        return True
    return name in ("localhost", bound.lower()) or (shared and name in (own, f"{own}.local"))


def is_loopback(host: str) -> bool:
    """Return whether `host`, a name or an address, is this computer only."""
    address = _parse_address(host)
    return host.lower() == "localhost" if address is None else address.is_loopback


def _parse_address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None
