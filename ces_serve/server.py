"""Runs the application until Ctrl-C, a thread for each connection.

This is Werkzeug's own server without its reloader and debugger. Its authors advise against it for sites on the
internet, for want of speed and hardening. Here one person looks at files of this computer.
"""

from __future__ import annotations

import errno
import socket
import threading
from pathlib import Path

from werkzeug.serving import BaseWSGIServer, WSGIRequestHandler, make_server

from ces_observer.errors import CesError
from ces_serve.app import Site, make_app

EVERYWHERE = ("0.0.0.0", "::")
IDLE_S = 120.0  # after which a silent connection is closed


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
    """A server of one folder; raises CesError if it cannot listen.

    `url` is where its overview is, `local_url` where this computer finds it: the same, unless it listens everywhere.
    """

    def __init__(self, folder: Path, host: str, port: int, signals: Path | None = None) -> None:
        self._site = Site.open(folder, signals)
        self._server = _listen(self._site, host, port)
        everywhere = host in EVERYWHERE
        self.url = _url(socket.gethostname() if everywhere else host, self._server.port)
        self.local_url = _url("localhost", self._server.port) if everywhere else self.url

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


def _url(host: str, port: int) -> str:
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"


def _listen(site: Site, host: str, port: int) -> BaseWSGIServer:
    """Return the listening server. The socket is opened here: Werkzeug would end the program if that fails."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen()
        app = make_app(site, host)
        return make_server(host, port, app, threaded=True, request_handler=QuietHandler, fd=listener.fileno())
    except OSError as error:
        raise CesError(_explain(error, host, port)) from None
    finally:
        listener.close()  # the server has a descriptor of its own


def _explain(error: OSError, host: str, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"port {port} of {host} is in use; choose another with --port, or 0 for a free one"
    if error.errno == errno.EACCES:
        return f"port {port} needs special rights; choose one from 1024 on with --port"
    return f"cannot listen on {host}, port {port}: {error.strerror or error}"
