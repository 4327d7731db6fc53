"""The desk: requests in, pages out, by Werkzeug's own server: for one person at this computer, not the internet.

Answered are pages of this server in the browser of whoever has its token.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import logging
import secrets
import shlex
import socket
from collections.abc import Callable
from importlib import import_module, resources
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from flask import Flask, Response, jsonify, redirect, render_template, request, send_file
from werkzeug.datastructures import MultiDict
from werkzeug.exceptions import HTTPException
from werkzeug.serving import BaseWSGIServer, make_server
from werkzeug.wrappers import Response as BaseResponse

from ces_cli.desk.folder import MODEL, RECORDING, REPORT, SUFFIXES, RefusedError, ServedFolder
from ces_cli.desk.jobs import PROGRAMS, STRUCTURES, DeskJob, Jobs, make_words
from ces_cli.desk.traces import Traces
from ces_observer import __version__
from ces_observer.errors import CesError
from ces_report.shell import replace_unencodable

POLICY = "Content-Security-Policy"
EMPTY_STYLE = "'sha256-47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU='"  # the style element that plotly.js fills
HEADERS = {
    POLICY: f"default-src 'none'; script-src 'self'; style-src 'self' {EMPTY_STYLE}; img-src 'self' data:; "
    "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # with less, browsers name no origin
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
# Files of the folder: their own scripts and styles, as in the file, in an origin of their own, and no connections.
FILE_POLICY = (
    "sandbox allow-scripts allow-modals; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; font-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)


def protect(app: Flask, token: str) -> None:
    """Check all requests to `app` and complete the headers of its responses; `/?token=` takes the token as a cookie."""
    cookie = f"ces_{hashlib.sha256(token.encode()).hexdigest()[:12]}"  # servers on other ports share the cookies

    @app.before_request
    def check() -> Response | None:
        asked, is_entry = request.headers, request.path == "/" and "token" in request.args
        given = request.args["token"] if is_entry else request.cookies.get(cookie, "")
        site, mode = asked.get("Sec-Fetch-Site"), asked.get("Sec-Fetch-Mode")
        is_page = request.method != "POST" or asked.get("Origin") == f"http://{request.host}"
        refusals = {
            "405 this server takes GET, HEAD and POST": request.method not in ("GET", "HEAD", "POST"),
            "421 unknown Host; open the address that ces serve has printed": not is_own_name(request.host),
            "403 requests from other sites are refused": site in ("cross-site", "same-site") and mode != "navigate",
            "403 only pages of this server change anything": not is_page,
            "403 open the address that ces serve has printed": not hmac.compare_digest(given.encode(), token.encode()),
        }
        for reason in (text for text, is_so in refusals.items() if is_so):
            return Response(f"{reason[4:]}\n", int(reason[:3]), mimetype="text/plain")  # and nothing of the folder
        return None

    @app.after_request
    def complete(response: Response) -> Response:
        if request.path == "/" and "token" in request.args and response.status_code == 200:
            response.set_cookie(cookie, token, httponly=True, samesite="Strict")
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)
        return response


def is_own_name(host: str) -> bool:
    """Return whether a Host header names this computer, with any port; DNS rebinding sends the name of its site."""
    name = (host[1:].partition("]") if host.startswith("[") else host.partition(":"))[0].lower()
    try:
        return name == "localhost" or ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


LOOPBACK = "127.0.0.1"
MAX_FILES, MAX_PIXELS, MAX_S = 60, 12_000, 1e10  # of a job, and of a chart
STATE = ("open", RECORDING, MODEL, "from", "to", "structure", "time")  # of the page, in its address
SENT = {".html", ".json", ".png", ".svg", ".txt", ".csv", ".yaml", ".xlsx"}  # files that the page links to
ASSETS = {"report.css": "ces_report", "desk.css": "ces_cli.desk", "desk.js": "ces_cli.desk"}


class Desk:
    """The pages of a folder, and what works on it; `app` answers who has the `token`. Raises CesError if it is none."""

    def __init__(self, path: Path, signals: Path | None = None) -> None:
        self.signals, self.token = "" if signals is None else str(signals.absolute()), secrets.token_urlsafe(24)
        self.folder = ServedFolder(path)
        self.jobs, self.traces = Jobs(self.folder.root), Traces(self.signals)
        self.app = Flask("ces_cli.desk", static_folder=None)
        protect(self.app, self.token)
        views: dict[str, Callable[..., Any]] = {"": self.page, "traces": self.draw, "assets/<name>": self.asset}
        views |= {"files/<path:path>": self.send, "upload": self.upload}
        views |= {f"run/<any({', '.join(PROGRAMS)}):program>": self.run, "cancel/<int:number>": self.cancel}
        for rule, view in views.items():
            way = "POST" if view in (self.run, self.cancel, self.upload) else "GET"
            self.app.add_url_rule(f"/{rule}", view_func=view, methods=[way])
        for kind in (HTTPException, CesError, OSError):
            self.app.register_error_handler(kind, explain)

    def listen(self, port: int) -> tuple[BaseWSGIServer, str]:
        """Return a server on this computer only, and its address with the token; raises CesError if there is none."""
        try:  # Werkzeug would end the program if the port is taken, and has a descriptor of its own afterwards
            with socket.socket() as listener:
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listener.bind((LOOPBACK, port))
                listener.listen()
                server = make_server(LOOPBACK, port, self.app, threaded=True, fd=listener.fileno())
        except OSError as error:
            remedy = f"{error.strerror or error}; choose another with --port, or 0 for a free one"
            raise CesError(f"cannot listen on {LOOPBACK}, port {port}: {remedy}") from None
        logging.getLogger("werkzeug").setLevel(logging.ERROR)  # no line for each request
        return server, f"http://{LOOPBACK}:{server.port}/?token={self.token}"

    def page(self) -> str:
        """Return the page; its address holds what is open and chosen."""
        args, items, jobs = request.args.copy(), self.folder.items(), self.jobs.list()
        job = next((one for one in jobs if str(one.number) == args.get("job")), None)
        files = self._list_files(job) if job else []
        opened = args.getlist("open")[-1:]
        if args.getlist("open")[:1] != opened:  # what is just opened is chosen alone, and whole
            for key in (RECORDING, "from", "to"):
                args.poplist(key)
        made = [one.path for one in items if one.kind == MODEL and one.path in files]
        args.setlist(RECORDING, args.getlist(RECORDING) or opened)
        args.setlist(MODEL, args.getlist(MODEL) or made)
        shown = {"version": __version__, "folder": self.folder.root, "opened": "".join(opened), "items": items}
        shown |= {"jobs": jobs, "job": job, "files": files, "suffixes": ",".join(SUFFIXES), "structures": STRUCTURES}
        page = render_template("desk.html", chosen=args, commands=self._commands(args), **shown)
        return replace_unencodable(page)

    def draw(self) -> Response:
        """Return the signals of a recording in a window as JSON, or how far its reading is."""
        args, path = request.args, self.folder.find(request.args.get("open", ""))
        try:
            bounds = (float(args["from"]), float(args["to"])) if "from" in args else None
            pixels = min(MAX_PIXELS, max(1, int(args["pixels"])))
            if bounds and not -MAX_S < bounds[0] < bounds[1] < MAX_S:
                raise ValueError
        except (KeyError, ValueError):
            raise RefusedError("expected from < to and pixels as numbers", 400) from None
        return jsonify(self.traces.ask(path, bounds, pixels))

    def run(self, program: str) -> BaseResponse:
        """Start a job and return to the page, which shows it."""
        for path in (*request.form.getlist(RECORDING), *request.form.getlist(MODEL)):
            self.folder.find(path)
        folder = self.jobs.next_folder(program)
        return _back(self.jobs.start(folder, make_words(request.form, program, folder, self.signals)))

    def cancel(self, number: int) -> BaseResponse:
        """Cancel a job and return to the page."""
        self.jobs.cancel(number)
        return _back(number)

    def upload(self) -> Response:
        """Write the body of the request as a file into the folder."""
        name = self.folder.receive(request.args.get("name", ""), request.content_length, request.stream)
        return jsonify({"name": name})

    def send(self, path: str) -> Response:
        """Return a model, a report or a result of a job in a sandbox; raises RefusedError for other files."""
        file, items = self.folder.find(path), {item.path: item.kind for item in self.folder.items()}
        is_result = any(file.is_relative_to(job.path) for job in self.jobs.list()) and file.suffix in SENT - {".html"}
        if not file.is_file() or not (is_result or items.get(path) in (MODEL, REPORT)):
            raise RefusedError(f"{path}: not a file that is shown")
        response = send_file(file, conditional=False, etag=False, max_age=None)
        response.headers[POLICY] = FILE_POLICY
        return response

    def asset(self, name: str) -> Response:
        """Return a style sheet, the script of the page, or that of the chart."""
        kind = "text/css" if name.endswith(".css") else "text/javascript"
        if name == "plotly.js":
            text = import_module("plotly.offline").get_plotlyjs()
            return Response(text, mimetype=kind, headers={"Cache-Control": "private, max-age=86400"})
        if name not in ASSETS:
            raise RefusedError("no such asset")
        folder = resources.files(ASSETS[name])
        return Response(
            (folder if name == "report.css" else folder / "templates").joinpath(name).read_bytes(), mimetype=kind
        )

    def _commands(self, chosen: MultiDict[str, str]) -> dict[str, tuple[str, str]]:
        """Return the command line by program, and the problem if it cannot be run now."""
        made = {}
        for program in PROGRAMS:
            try:
                words = make_words(chosen, program, self.jobs.next_folder(program), self.signals)
                made[program] = (shlex.join(["ces", program, *words]), "")
            except CesError as error:
                made[program] = ("", str(error))
        return made

    def _list_files(self, job: DeskJob) -> list[str]:
        """Return the files of a job that can be shown, pages first."""
        paths = [path for path in job.path.rglob("*") if path.suffix in SENT and path.is_file()]
        names = sorted(paths, key=lambda path: (path.suffix != ".html", path))[:MAX_FILES]
        return [path.relative_to(self.folder.root).as_posix() for path in names]


def explain(error: Exception) -> Response:
    """Return what is wrong as one line of text."""
    text, status = getattr(error, "description", str(error)), getattr(error, "status", 409)
    return Response(f"{text}\n", getattr(error, "code", status), mimetype="text/plain")


def _back(number: int) -> BaseResponse:
    """Return to the page with all that was chosen, at a job."""
    state = [(key, value) for key in STATE for value in request.form.getlist(key) if value]
    return redirect(f"/?{urlencode([*state, ('job', number)])}#job", 303)
