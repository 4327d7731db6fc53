"""Progress of a blind test: a live bar on a terminal, a line for each case in a log."""

from __future__ import annotations

from types import TracebackType

from ces_cli.terminal import terminal
from ces_cli.terminal.counted_bar import counted_bar


class CasesProgress:
    """Shows how many of `total` cases are done, `already` of them from an earlier run."""

    def __init__(self, total: int, already: int = 0) -> None:
        self.total, self.done = total, already
        self._bar = counted_bar("cases")
        self._task = self._bar.add_task("", total=total, completed=already)

    def __enter__(self) -> CasesProgress:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._bar.stop()

    def hear(self, text: str) -> None:
        """Hear of a case that ended."""
        self.done += 1
        self._bar.update(self._task, completed=self.done, description=text)
        if self._bar.disable:
            terminal.err.print(f"{self.done:5}/{self.total}  {text}", highlight=False, soft_wrap=True)
