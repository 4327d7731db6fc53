"""`ces serve`: shows what is in a folder as pages in the browser, read-only and on this computer only."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import urlsplit

from ces_cli.terminal import terminal
from ces_cli.terminal.options import SIGNALS
from ces_observer.errors import CesError

LOOPBACK = "127.0.0.1"
PORT = 8000
ENDS = ("SIGTERM", "SIGHUP")  # of a service, and of an ssh connection that breaks
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
CHOSEN = "BROWSER"  # the person's own choice, also of editors that forward ports


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program until Ctrl-C; returns the exit status."""
    options = make_parser().parse_args(argv)
    if find_spec("flask") is None:
        raise CesError("Flask is not installed; pip install 'ces_observer[serve]' (or apt install python3-flask)")
    if options.signals is not None:
        terminal.load_described_signals(options)  # raises now, not when a recording is opened
    from ces_serve.security import is_loopback
    from ces_serve.server import PageServer

    server = PageServer(options.folder, options.host, options.port, options.signals)
    if not is_loopback(options.host):
        terminal.print_warning(f"--host {options.host}: everyone on that network can read {options.folder}")
    with suppress(KeyboardInterrupt):
        _end_in_order()
        print(f"{options.folder}: {server.url}  (Ctrl-C ends it)", flush=True)
        if options.open:
            open_browser(server.local_url)
        server.run()
    print("stopped")
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "serve",
        "Show what is in a folder and below it as pages in the browser: models, reports, campaigns, diagnoses, fleets, "
        "recordings, and searches while they run. Nothing is written. Ctrl-C ends it.",
        "ces serve . --open",
    )
    p.add_argument("folder", type=Path, metavar="DIR", help="the folder to show")
    whole = terminal.integer_between
    text = f"port to listen on; 0 for a free one (default {PORT})"
    p.add_argument("--port", type=whole(0, 65535), default=PORT, metavar="N", help=text)
    text = (
        f"address to listen on (default {LOOPBACK}: this computer only); with another, all of its network can read DIR"
    )
    p.add_argument("--host", default=LOOPBACK, metavar="ADDRESS", help=text)
    p.add_argument("--open", action="store_true", help="open the page in the browser")
    terminal.add_options(p, SIGNALS)
    return p


def _end_in_order() -> None:
    """End at the other signals as at Ctrl-C, so that temporary files go; not at one that is ignored, as under nohup."""
    for number in (getattr(signal, name) for name in ENDS if hasattr(signal, name)):
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


def open_browser(url: str) -> None:
    """Open `url`, or say how to see it where there is no desktop, as over ssh.

    Browsers may be waited for until their end, so this happens in a thread. Without a desktop Python would start a text
    browser, if there is one, in the terminal of the server; the pages need more.
    """
    if has_desktop(os.environ):
        threading.Thread(target=_open, args=(url,), daemon=True).start()
    else:
        terminal.print_warning(f"--open: no desktop here; {explain_tunnel(url, socket.gethostname())}")


def has_desktop(environment: Mapping[str, str], platform: str = sys.platform) -> bool:
    """Return whether a browser with a window can be expected."""
    needs_display = platform not in ("darwin", "win32", "cygwin")
    return not needs_display or any(environment.get(name) for name in (*DISPLAYS, CHOSEN))


def explain_tunnel(url: str, computer: str) -> str:
    """Return how another computer can show the page at `url`, an address on `computer` itself."""
    port = urlsplit(url).port
    return f"on yours, run ssh -N -L {port}:localhost:{port} {computer} and open http://localhost:{port}/"


def _open(url: str) -> None:
    if not webbrowser.open(url):
        terminal.print_warning("--open: no browser could be started; open the address above")
