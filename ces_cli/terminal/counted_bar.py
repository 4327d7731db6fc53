"""A live bar that counts things on a terminal: what every long run of many shows."""

from __future__ import annotations

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ces_cli.terminal import terminal


def counted_bar(things: str) -> Progress:
    """Return a bar labelled `things`, disabled where the error stream is no terminal."""
    return Progress(
        TextColumn(things),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
        console=terminal.err,
        transient=True,
        disable=not terminal.err.is_terminal,
    )
