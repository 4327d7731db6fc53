"""The separate process of the node `identify` that runs the search, so that it does not block the node's executor.

The command line of `ces identify` comes in. One JSON object per line goes out on standard output, warnings as text on
standard error. The process ends when its standard input closes, which happens when the node ends. SIGINT acts as Ctrl-C
does on the program: it stops the search with the best model so far, and any other stage without a model.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, NoReturn

from ces_cli.identify.process import READING, SEARCHING, WRITING
from ces_cli.identify.program import make_parser, prepare_identification, write_report_page
from ces_cli.terminal import terminal
from ces_cli.terminal.progress import BestResults
from ces_identify.numerics.search import Limits, SearchResult
from ces_identify.validation.evaluate import describe_size
from ces_observer.errors import CesError

SEND_EVERY_S = 0.2

Send = Callable[[dict[str, Any]], None]


def main(argv: Sequence[str] | None = None) -> int:
    """Identify a model; returns 0, 2 after a user's mistake, or 130 if SIGINT came before the first model."""
    send = _redirect_stdout()
    threading.Thread(target=_exit_with_node, daemon=True).start()
    try:
        terminal.interrupt_as_exception()
        send({"result": _identify(list(sys.argv[1:] if argv is None else argv), send)})
    except CesError as error:
        send({"error": name_parameters(str(error))})
        return terminal.USER_ERROR
    except OSError as error:
        send({"error": f"{error.filename}: {error.strerror}" if error.filename else str(error)})
        return terminal.USER_ERROR
    except KeyboardInterrupt:
        return terminal.INTERRUPTED
    return 0


def _identify(words: list[str], send: Send) -> dict[str, Any]:
    """Identify, write model and report, and return the message that the node publishes: facts and costs."""
    options = _options(words)
    send({"stage": READING})
    result = prepare_identification(options).run(lambda limits: SearchReporter(limits, send))
    if options.report is not None:
        write_report_page(result, options, terminal.command_line("identify", words))
    best, model = result.search_results[0], result.model
    facts = {
        "model": str(options.out.absolute()),
        "model sha256": model.digest(),
        "report": "" if options.report is None else str(options.report.absolute()),
        "structure": model.structure,
        "size": describe_size(model),
        "rate [Hz]": f"{model.sampling.rate_Hz:g}",
        "best seed": str(best.seed),
        "search ended": best.ended,
        "proved stable": "yes" if model.certificate else "no",
    }
    costs = [
        {"recording": e.name, "role": e.role, "J [%]": f"{e.cost:.4f}", "rms [N]": f"{e.rms_N:.2f}"}
        for e in result.evaluations
    ]
    return {"facts": facts, "costs": costs}


class SearchReporter:
    """Sends the best cost so far, at most five times a second; `listen` may be called from any thread."""

    def __init__(self, limits: Limits, send: Send) -> None:
        self._limits, self._send = limits, send
        self._lock = threading.Lock()
        self._results = BestResults(limits.starts)
        self._sent_at = time.monotonic()

    def __enter__(self) -> SearchReporter:
        self._send({"stage": SEARCHING, "starts": self._limits.starts})
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        if kind is None:
            self._send_best()
            self._send({"stage": WRITING})

    def listen(self, result: SearchResult) -> None:
        """Receive an improvement or the end of a start."""
        with self._lock:
            self._results.update(result)
            if time.monotonic() - self._sent_at >= SEND_EVERY_S:
                self._send_best()

    def _send_best(self) -> None:
        self._sent_at = time.monotonic()
        best = self._results.best
        if best is not None:
            done = {"ended": self._results.finished, "share": self._results.share}
            self._send({"cost": best.cost, "size": len(best.chosen), **done})


def _options(words: list[str]) -> argparse.Namespace:
    """Return the options; raises CesError with the parser's message."""
    parser = make_parser()

    def refuse(message: str) -> NoReturn:
        raise CesError(message.removeprefix("argument "))

    parser.error = refuse  # type: ignore[method-assign]
    return parser.parse_args(words)


def name_parameters(text: str) -> str:
    """Return an error of the program with its options named as the node's parameters."""

    def name(match: re.Match[str]) -> str:
        return f"parameter {match[1].removeprefix('no-').replace('-', '_')}"

    return re.sub(r"(?<![\w-])--([a-z][a-z-]*[a-z])", name, text)


def _redirect_stdout() -> Send:
    """Return a function that writes messages to standard output; redirect all other output to standard error."""
    stream = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    lock = threading.Lock()

    def send(message: dict[str, Any]) -> None:
        with lock:
            stream.write(json.dumps(message) + "\n")
            stream.flush()

    return send


def _exit_with_node() -> None:
    os.read(sys.stdin.fileno(), 1)  # not sys.stdin.read(), whose lock would be held when the interpreter ends
    os._exit(terminal.INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
