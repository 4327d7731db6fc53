"""The starts of a search as scripts and notebooks see them: a table, and a DataFrame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ces_data.reading import import_pandas
from ces_identify.numerics.search import SearchResult
from ces_report.table import PrintedResults, Table, summarize_result, text_table

NONE = "no search is known; of a model from a file, provenance['selection'] tells how the search ended"


class SearchResults(PrintedResults[SearchResult]):
    """The starts of a search, the best first."""

    def __getitem__(self, at: Any) -> Any:
        """Return one or some of them. Raises IndexError, which says where a model file has the outcome."""
        if not self:
            raise IndexError(NONE)
        return super().__getitem__(at)

    def to_frame(self) -> Any:
        """Return a DataFrame: structure (of several), seed, size, cost on the selection data [%], trials, end."""
        columns = ["structure", "seed", "size", "selection_J_percent", "trials", "ended"]
        return import_pandas().DataFrame(map(_start_facts, self), columns=columns)


def _start_facts(start: SearchResult) -> tuple[str, int, int, float, int, str]:
    return start.structure, start.seed, len(start.chosen), start.cost, start.trials, start.ended


@summarize_result.register
def _(starts: SearchResults) -> tuple[Sequence[str], Table[Sequence[str]]]:
    rows = [
        (name, str(n), str(size), f"{J:.2f}", str(trials) if trials else "", ended)
        for name, n, size, J, trials, ended in map(_start_facts, starts)
    ]
    return [] if rows else [NONE], text_table(["structure", "seed", "size", "selection J %", "trials", "ended"], rows)
