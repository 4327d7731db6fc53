"""Names of a campaign's cells that a person can tell apart: in the terminal, the tables, the page and comparisons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ces_identify.jobs.row_log import Row

COUNTED = ("terms", "units", "rules", "springs", "curves", "memberships")


@dataclass(frozen=True)
class CellNames:
    """Names cells by their structure and the settings in `varied`, and with their set of bags if there are several."""

    varied: tuple[str, ...]
    with_bags: bool

    def name(self, row: Row) -> str:
        """Return the structure of a cell and its settings that vary: polynomial, 12 terms, seed 1."""
        return ", ".join(filter(None, [row["structure"], self.settings(row)]))

    def full_name(self, row: Row) -> str:
        """Return the name of a cell with its set of bags, if there are several."""
        return f"{row['bags']}: {self.name(row)}" if self.with_bags else self.name(row)

    def settings(self, row: Row) -> str:
        """Return the settings of a cell that vary: 12 terms, seed 1."""
        return ", ".join(describe_setting(key, row[key]) for key in self.varied if key in row)


def describe_setting(key: str, value: Any) -> str:
    """Return a setting as text: 12 terms, seed 1, certificate yes."""
    if isinstance(value, bool):
        return f"{key} {'yes' if value else 'no'}"
    return f"{value} {key}" if key in COUNTED else f"{key} {value}"
