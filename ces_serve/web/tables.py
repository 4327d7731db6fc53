"""What the page of a thing shows, before it is HTML: facts, tables, charts and links."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from markupsafe import Markup


@dataclass(frozen=True)
class PageCell:
    """A cell: its text, a link, whether it is a number; `pick` is the path of a model that can be chosen to compare."""

    text: str
    href: str = ""
    numeric: bool = False
    pick: str = ""


@dataclass(frozen=True)
class PageTable:
    """A table with a caption, perhaps a chart above it; `headings` are texts, rows of cells below them."""

    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[PageCell, ...], ...]
    note: str = ""
    chart: Markup | None = None

    @property
    def picks(self) -> bool:
        """Whether models in it can be chosen to compare."""
        return any(cell.pick for row in self.rows for cell in row)

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Which columns hold numbers."""
        return tuple(cell.numeric for cell in self.rows[0]) if self.rows else (False,) * len(self.headings)


@dataclass
class PageContent:
    """The content of a page in its order: headline, warnings, facts (name and value), charts, tables, links."""

    headline: str = ""
    warnings: list[str] = field(default_factory=list)
    facts: list[tuple[str, str]] = field(default_factory=list)
    charts: list[Markup] = field(default_factory=list)
    tables: list[PageTable] = field(default_factory=list)
    links: list[tuple[str, str]] = field(default_factory=list)


def upper_first(text: str) -> str:
    """Return a text that begins with a capital letter."""
    return text[:1].upper() + text[1:]


def number(value: object, form: str, unit: str = "") -> str:
    """Return a number with its unit as text, a dash for None."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return "–"
    return f"{value:{form}}".replace("-", "−") + (f" {unit}" if unit else "")


def cell(value: object, form: str, scale: float = 1.0) -> PageCell:
    """Return a cell with a number, a dash for None."""
    shown = value * scale if scale != 1.0 and isinstance(value, int | float) else value
    return PageCell(number(shown, form), numeric=True)


def join(texts: Iterable[object]) -> str:
    """Return texts in one line, a dash for none."""
    return ", ".join(map(str, texts)) or "–"
