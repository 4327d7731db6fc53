"""The results of a campaign on disk: a line of JSON for each cell as it ends, and its model beside."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from ces_identify.campaign.cell import DONE, FAILED, Outcome, Row
from ces_identify.jobs.row_log import RowLog, open_rows
from ces_observer.checked import write_beside
from ces_observer.errors import CesError

FILE = "results.jsonl"


class Results:
    """The rows of a campaign by key, and the models they tell of; made by `open_results`."""

    def __init__(self, folder: Path, log: RowLog) -> None:
        self.folder = folder
        self._log = log

    @property
    def rows(self) -> dict[str, Row]:
        """The rows that are there, by key."""
        return self._log.rows

    def model(self, key: str) -> Path:
        """Return where the model of a cell is, or would be."""
        return self.folder / "models" / f"{key}.json"

    def has(self, key: str) -> bool:
        """True if the cell need not be computed: it is done and its model there, or it failed for good."""
        status = self.rows.get(key, {}).get("status")
        return status == FAILED or (status == DONE and self.model(key).exists())

    def add(self, outcome: Outcome) -> None:
        """Write the model, then the row that says it is there. Raises CesError or OSError if the disk is full."""
        if outcome.model is not None:
            write_beside(self.model(outcome.row["key"]), outcome.model)
        self._log.add(outcome.row)

    def refresh(self) -> None:
        """Take the rows from the file again, after Ctrl-C that may have come in the middle of `add`."""
        self._log.refresh()


@contextlib.contextmanager
def open_results(folder: Path) -> Iterator[Results]:
    """Open the results in `folder`, which is made if need be, and hold them against a second run.

    Raises CesError if another run holds them, or if a line that is not the last cannot be read.
    """
    try:
        (folder / "models").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CesError(f"{folder}: cannot be written: {error.strerror}; choose another folder") from None
    with open_rows(folder / FILE, "a campaign") as log:
        yield Results(folder, log)
