"""The separate process of the node `identify` that runs the search, so that it does not block the node's executor.

The request comes in as one line of JSON: the values of options that are given, by their names. One JSON object per line
goes out on standard output, warnings as text on standard error. The process ends when its standard input closes, which
happens when the node ends. SIGINT acts as Ctrl-C does on the program: it stops the search with the best model so far,
and any other stage without a model.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
import threading
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any

from ces_cli.identify.process import READING, SEARCHING, WRITING
from ces_cli.identify.program import prepare_identification, write_report_page
from ces_cli.identify.request import BAGS, IdentifyProgramRequest, list_shared
from ces_cli.terminal import terminal
from ces_cli.terminal.progress import BestResults
from ces_data.compilation import CompilationNotice
from ces_identify.numerics.search import Limits, SearchResult
from ces_identify.validation.evaluate import describe_size
from ces_observer.errors import CesError, OptionName

SEND_EVERY_S = 0.2

Send = Callable[[dict[str, Any]], None]


def main() -> int:
    """Identify a model; returns 0, 2 after a user's mistake, or 130 if SIGINT came before the first model."""
    send = _redirect_stdout()
    given = json.loads(_read_line())
    threading.Thread(target=_exit_with_node, daemon=True).start()
    CompilationNotice(terminal.print_warning)
    try:
        terminal.interrupt_as_exception()
        send({"result": _identify(given, send)})
    except CesError as error:
        send({"error": error.word(OptionName.as_parameter)})
        return terminal.USER_ERROR
    except OSError as error:
        send({"error": f"{error.filename}: {error.strerror}" if error.filename else str(error)})
        return terminal.USER_ERROR
    except KeyboardInterrupt:
        return terminal.INTERRUPTED
    return 0


def _identify(given: Mapping[str, Any], send: Send) -> dict[str, Any]:
    """Identify, write model and report, and return the message that the node publishes: facts and costs."""
    request = IdentifyProgramRequest.of(given, given)
    send({"stage": READING})
    work = prepare_identification(request)
    result = work.run(lambda limits: SearchReporter(limits, send))
    write_report_page(result, work, as_command(given))
    best, model = result.search_results[0], result.model
    facts = {
        "model": str(request.out.absolute()),
        "model sha256": model.digest(),
        "report": "" if work.report is None else str(work.report.absolute()),
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

    def listen(self, news: SearchResult | str) -> None:
        """Receive an improvement, the end of a start, or the step that begins, which is not sent."""
        with self._lock:
            if isinstance(news, str):
                return
            self._results.update(news)
            if time.monotonic() - self._sent_at >= SEND_EVERY_S:
                self._send_best()

    def _send_best(self) -> None:
        self._sent_at = time.monotonic()
        best = self._results.best
        if best is not None:
            done = {"ended": self._results.finished, "share": self._results.share}
            self._send({"cost": best.cost, "size": len(best.chosen), **done})


def as_command(given: Mapping[str, Any]) -> str:
    """Return the command of `ces identify` that asks for the same, as reports state it."""
    words = []
    for option in list_shared():
        values = given.get(option.name, ())
        if option.kind is bool:
            words += [option.flag] if option.name in given else []
        elif option.together:
            words += [option.flag, *values] if values else []
        else:
            words += [f"{option.flag}={value}" for value in (values if isinstance(values, list | tuple) else [values])]
    return shlex.join(["ces", "identify", *words, "--", *given[BAGS.name]])


def _read_line() -> bytes:
    """Return the first line of standard input, byte by byte, so that the end of the input can be awaited elsewhere."""
    line = b""
    while not line.endswith(b"\n") and (byte := os.read(sys.stdin.fileno(), 1)):
        line += byte
    return line


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
