"""`ces serve`: shows what is in a folder as pages in the browser, read-only and on this computer only."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.options import SIGNALS, Argument
from ces_observer.errors import CesError
from ces_observer.options import Option

LOOPBACK = "127.0.0.1"
ENDS = ("SIGTERM", "SIGHUP")  # of a service, and of an ssh connection that breaks


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program until Ctrl-C; returns the exit status."""
    options = make_parser().parse_args(argv)
    if find_spec("flask") is None:
        raise CesError("Flask is not installed; pip install 'ces_observer[serve]' (or apt install python3-flask)")
    if options.signals is not None:
        terminal.load_described_signals(options)  # raises now, not when a recording is opened
    from ces_cli.desk.app import PageServer, is_loopback

    server = PageServer(options.folder, options.host, options.port, options.signals)
    if not is_loopback(options.host):
        terminal.print_warning(f"--host {options.host}: everyone on that network can read {options.folder}")
    with suppress(KeyboardInterrupt):
        for number in (getattr(signal, name) for name in ENDS if hasattr(signal, name)):
            if signal.getsignal(number) != signal.SIG_IGN:  # as under nohup
                signal.signal(number, signal.default_int_handler)
        print(f"{options.folder}: {server.url}  (Ctrl-C ends it)", flush=True)
        server.run()
    print("stopped")
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    host = "address to listen on; with another than that of this computer only, all of its network can read DIR"
    return terminal.parser(
        "serve",
        "Show what is in a folder and below it as pages in the browser: models, reports, campaigns, diagnoses, fleets "
        "and recordings. Nothing is written. Ctrl-C ends it.",
        "ces serve .",
        Argument("folder", meaning="the folder to show", kind=Path, metavar="DIR"),
        Option("port", 8000, "port to listen on; 0 for a free one", 0, 65535, metavar="N"),
        Option("host", LOOPBACK, host, metavar="ADDRESS"),
        SIGNALS,
    )
