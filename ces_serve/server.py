"""Runs the application until Ctrl-C, a thread for each connection.

This is Werkzeug's own server without its reloader and debugger. Its authors advise against it for sites on the
internet, for want of speed and hardening. Here one person looks at files of this computer.
"""

from __future__ import annotations

import socket
import threading
from pathlib import Path

from werkzeug.serving import WSGIRequestHandler, make_server

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
