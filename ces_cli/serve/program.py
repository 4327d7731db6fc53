"""`ces serve`: shows what is in a folder as pages in the browser, read-only and on this computer only."""

from __future__ import annotations

import argparse
import re
import signal
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from ces_cli.serve.desktop import open_browser
from ces_cli.terminal import terminal
from ces_observer.errors import CesError

LOOPBACK = "127.0.0.1"
PORT = 8000
ENDS = ("SIGTERM", "SIGHUP")  # of a service, and of an ssh connection that breaks


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program until Ctrl-C; returns the exit status."""
    options = make_parser().parse_args(argv)
    if find_spec("flask") is None:
        raise CesError("Flask is not installed; pip install 'ces_observer[serve]' (or apt install python3-flask)")
    if options.signals is not None:
        terminal.load_described_signals(options)  # raises now, not when a recording is opened
    _serve(options)
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "serve",
        "Show what is in a folder and below it as pages in the browser: models, reports, campaigns, diagnoses, fleets, "
        "recordings, searches while they run, and a running observer where ROS 2 is sourced. Nothing is written. "
        "Ctrl-C ends it.",
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
    text = "show only the observer of this node name, such as observer or car/observer (default: all)"
    p.add_argument("--observer", type=_parse_node_name, metavar="NAME", help=text)
    terminal.add_signals(p)
    return p


def _parse_node_name(text: str) -> str:
    if not re.fullmatch(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"'{text}' is not the name of a node, such as observer or car/observer")
    return text


def _serve(options: argparse.Namespace) -> None:
    from ces_serve.web.security import is_loopback
    from ces_serve.web.server import PageServer

    server = PageServer(options.folder, options.host, options.port, options.observer or "", options.signals)
    if not is_loopback(options.host):
        terminal.print_warning(f"--host {options.host}: everyone on that network can read {options.folder}")
    with suppress(KeyboardInterrupt):
        _end_in_order()
        print(f"{options.folder}: {server.url}  (Ctrl-C ends it)", flush=True)
        if options.open:
            open_browser(server.local_url)
        server.run()
    print("stopped")


def _end_in_order() -> None:
    """End at the other signals as at Ctrl-C, so that temporary files go; not at one that is ignored, as under nohup."""
    for number in (getattr(signal, name) for name in ENDS if hasattr(signal, name)):
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)
