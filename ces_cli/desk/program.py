"""`ces serve`: shows what is in a folder as pages in the browser, read-only and on this computer only."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.heartbeat import heartbeat
from ces_cli.terminal.options import SIGNALS, ProgramRequest, argument, option
from ces_data.signals_file import load_signals
from ces_observer.errors import CesError
from ces_observer.records import declare

LOOPBACK = "127.0.0.1"
HOST = "address to listen on; with another than that of this computer only, all of its network can read DIR"
ENDS = ("SIGTERM", "SIGHUP")  # of a service, and of an ssh connection that breaks


@dataclass(frozen=True, kw_only=True)
class ServeRequest(ProgramRequest):
    """What `ces serve` is asked for."""

    folder: Path = argument(meaning="the folder to show", metavar="DIR")
    port: int = option(8000, "port to listen on; 0 for a free one", 0, 65535, metavar="N")
    host: str = option(LOOPBACK, HOST, metavar="ADDRESS")
    signals: Path | None = declare(SIGNALS)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program until Ctrl-C; returns the exit status."""
    request = make_parser().read(argv)
    if find_spec("flask") is None:
        raise CesError("Flask is not installed; pip install 'ces_observer[serve]' (or apt install python3-flask)")
    if request.signals is not None:
        load_signals(request.signals)  # raises now, not when a recording is opened
    from ces_cli.desk.app import PageServer, is_loopback

    server = PageServer(request.folder, request.host, request.port, request.signals)
    if not is_loopback(request.host):
        terminal.print_warning(f"--host {request.host}: everyone on that network can read {request.folder}")
    with suppress(KeyboardInterrupt):
        for number in (getattr(signal, name) for name in ENDS if hasattr(signal, name)):
            if signal.getsignal(number) != signal.SIG_IGN:  # as under nohup
                signal.signal(number, signal.default_int_handler)
        print(f"{request.folder}: {server.url}  (Ctrl-C ends it)", flush=True)
        heartbeat.stop()
        server.run()
    print("stopped")
    return 0


def make_parser() -> terminal.Parser[ServeRequest]:
    """Return the parser of the program."""
    return terminal.parser(
        "serve",
        "Show what is in a folder and below it as pages in the browser: models, reports, campaigns, diagnoses, fleets "
        "and recordings. Nothing is written. Ctrl-C ends it.",
        "ces serve .",
        ServeRequest,
    )
