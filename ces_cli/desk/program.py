"""`ces serve`: a desk in the browser for the recordings and models of a folder, on this computer only."""

from __future__ import annotations

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

NEEDS = {"flask": "python3-flask", "plotly": "python3-plotly"}  # by module: the package of Ubuntu


@dataclass(frozen=True, kw_only=True)
class ServeRequest(ProgramRequest):
    """What `ces serve` is asked for."""

    program = "serve"
    about = (
        "Work in a folder with the browser: see recordings, choose a range, run programs, read their reports. Every "
        "button shows its command; files stay in the folder. Ctrl-C ends it, but no job that runs."
    )
    example = "ces serve ."

    folder: Path = argument(meaning="the folder to work in", metavar="DIR")
    port: int = option(8000, "port to listen on; 0 for a free one", 0, 65535, metavar="N")
    signals: Path | None = declare(SIGNALS)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program until Ctrl-C; returns the exit status."""
    request = terminal.read(ServeRequest, argv)
    if missing := [name for name in NEEDS if find_spec(name) is None]:
        apt = " ".join(NEEDS[name] for name in missing)
        raise CesError(f"{' and '.join(missing)}: not installed; pip install 'ces_observer[serve]' (apt install {apt})")
    load_signals(request.signals)  # raises now, not when a recording is opened
    from ces_cli.desk.app import Desk

    server, url = Desk(request.folder, request.signals).listen(request.port)
    with suppress(KeyboardInterrupt):
        print(f"{request.folder}: {url}  (Ctrl-C ends it)", flush=True)
        heartbeat.stop()
        server.serve_forever(poll_interval=0.2)
    print("stopped; a job that runs goes on")
    return 0
