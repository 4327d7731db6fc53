"""What `ces iterate` shows: a bar of recorded seconds, the present step, and a line for each finished iteration."""

from __future__ import annotations

from collections.abc import Callable

from rich.console import Console
from rich.progress import TextColumn, TimeElapsedColumn

from ces_cli.terminal import terminal
from ces_cli.terminal.progress import LiveBar
from ces_identify.polynomial.search_limits import SearchResult
from ces_identify.progress_file import SearchProgressFile
from ces_iterate.loop.iterate import IterateListener
from ces_iterate.loop.store import Iteration


class IterateProgress(LiveBar, IterateListener):
    """Shows an iteration; `listen_search` may be called from any thread."""

    def __init__(self, budget_s: float, lines_to: Console = terminal.out) -> None:
        columns = (TextColumn("{task.completed:.0f} of {task.total:.0f} s recorded"), TimeElapsedColumn())
        super().__init__("iterating", *columns, total=budget_s, text="(Ctrl-C stops; the same command goes on)")
        self.after_iteration: Callable[[], None] = lambda: None
        self.file: SearchProgressFile | None = None  # once the folder of the iteration is there
        self._lines_to, self._recorded_s, self._step = lines_to, 0.0, ""

    def begin(self, number: int, step: str) -> None:
        """Show the step that begins."""
        self._step = f"iteration {number}: {step}"
        if self.file is not None:
            self.file.begin_step(self._step)
        self.show(self._recorded_s, self._step)
        self.log(f"{self.elapsed_s:5.0f} s  {self._step}")

    def listen_search(self, result: SearchResult) -> None:
        """Show the newest cost of the search."""
        with self._lock:
            text = f"{self._step}: selection cost J = {result.cost:.2f} %"
            self.show(self._recorded_s, text)
            self.log_seldom(text)
            if self.file is not None:
                self.file.listen(result)

    def finish(self, iteration: Iteration) -> None:
        """Print the result of an iteration."""
        self._recorded_s = iteration.total_s
        self.show(self._recorded_s, self._step)
        self._lines_to.print(format_iteration(iteration), highlight=False, soft_wrap=True)
        self.after_iteration()


def format_iteration(iteration: Iteration) -> str:
    """Return the line of an iteration."""
    fresh = "no model yet" if iteration.fresh_J is None else f"J {iteration.fresh_J:.2f} % on it before it was used"
    least = max(iteration.regions, key=lambda region: float(region["unknown"]))
    validation = "".join(f", {name} {cost:.2f} %" for name, cost in iteration.validation_J.items())
    return (
        f"{iteration.name}: {iteration.recorded_s:.1f} s recorded ({iteration.total_s:.1f} s in all); {fresh}, "
        f"{iteration.fit_J:.2f} % after the fit{validation}; {100 * iteration.coverage:.0f} % of the states covered; "
        f"least known: {least['axis']} {least['low']:.3g} to {least['high']:.3g} {least['unit']}"
    )
