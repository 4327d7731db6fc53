"""Progress of many results: a live bar on a terminal, a line for each as it comes in a log."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType

from ces_cli.terminal import terminal
from ces_cli.terminal.counted_bar import counted_bar
from ces_identify.campaign.cell import DONE, Row


class CampaignProgress:
    """Shows how many of `total` results are there, `already` of them from an earlier run.

    `things` is what they are called, `tell` says in words what a row is.
    """

    def __init__(
        self, total: int, already: int, things: str = "cells", tell: Callable[[Row], str] | None = None
    ) -> None:
        self.total, self.there, self.failed, self._tell = total, already, 0, tell or _cell
        self._bar = counted_bar(things)
        text = f"{already} from an earlier run" if already else "(Ctrl-C keeps what is finished)"
        if already and self._bar.disable:
            terminal.err.print(f"{already} of {total} {things} are there from an earlier run", highlight=False)
        self._task = self._bar.add_task(text, total=total, completed=already)

    def __enter__(self) -> CampaignProgress:
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        self._bar.stop()

    def listen(self, row: Row) -> None:
        """Hear of one that ended."""
        self.there += 1
        self.failed += row["status"] != DONE
        text = self._tell(row)
        failures = f"; {self.failed} failed" if self.failed else ""
        self._bar.update(self._task, completed=self.there, description=text + failures)
        if self._bar.disable:
            terminal.err.print(f"{self.there:5}/{self.total}  {text}", highlight=False, soft_wrap=True)


def _cell(row: Row) -> str:
    return f"{row['bags']}, {row['structure']}, seed {row['seed']}: {told(row)}"


def told(row: Row) -> str:
    """Say in a few words how a cell ended."""
    if row["status"] != DONE:
        return f"{row['status']}: {row['reason']}"
    cost = "diverged" if row["selection_J"] is None else f"{row['selection_J']:.2f} %"
    return f"selection J {cost}, {row['parameters']} parameters, {row['seconds']:.1f} s"
