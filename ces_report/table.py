"""A table declared once: columns with headings, text and meaning over rows; rendered for pages and terminals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from markupsafe import Markup

R = TypeVar("R")


@dataclass(frozen=True)
class Column(Generic[R]):
    """A column: its `heading`, the `text` of a row in it, and what it means.

    `figure` if it holds numbers. On pages, `html` replaces the text (links, bars), `css` and `head_css` name the
    classes of cells and heading, and `value` is sorted by where the text does not say it all. A terminal shows the
    heading `short`; a column without it is left out there if the column is `page_only`, and `terminal_only` ones are
    left out on pages.
    """

    heading: str
    text: Callable[[R], str]
    meaning: str = ""
    figure: bool = False
    html: Callable[[R], Markup] | None = None
    css: str = ""
    page_only: bool = False
    terminal_only: bool = False
    short: str = ""
    head_css: str = ""
    value: Callable[[R], object] | None = None


@dataclass(frozen=True)
class Table(Generic[R]):
    """Columns over rows; a terminal shows `title`, and lines between groups; `left_out` rows are not in this table."""

    columns: Sequence[Column[R]]
    rows: Sequence[R]
    title: str = ""
    left_out: int = 0
    group: Callable[[R], object] | None = None

    def to_html(
        self, css: str = "plain", row_css: Callable[[R], str] = lambda row: "", repeat_heads: bool = True
    ) -> Markup:
        """Return the table of class `css` with rows of `row_css`; `repeat_heads` in cells, for narrow screens."""
        columns = [c for c in self.columns if not c.terminal_only]
        heads = Markup("").join(map(_head, columns))
        body = Markup("").join(
            Markup("<tr{}>{}</tr>\n").format(
                _attribute("class", row_css(row)), Markup("").join(_cell(c, row, repeat_heads) for c in columns)
            )
            for row in self.rows
        )
        head = Markup("<thead><tr>{}</tr></thead>").format(heads) if any(c.heading for c in columns) else ""
        return Markup('<table class="{}">{}<tbody>\n{}</tbody></table>').format(css, head, body)

    def __str__(self) -> str:
        """Return the table as plain text, as a terminal shows it."""
        shown = [column for column in self.columns if not column.page_only]
        lines = [[c.short or c.heading for c in shown], *([c.text(row) for c in shown] for row in self.rows)]
        columns = [[text.replace("\n", ", ") for text in texts] for texts in zip(*lines, strict=True)]
        justified = []
        for column, texts in zip(shown, columns, strict=True):
            width = max(map(len, texts))
            justified.append([text.rjust(width) if column.figure else text.ljust(width) for text in texts])
        return "\n".join("  ".join(line).rstrip() for line in zip(*justified, strict=True))


def _head(column: Column[R]) -> Markup:
    classes = " ".join(filter(None, ["n" * column.figure, column.head_css]))
    attributes = _attribute("class", classes) + _attribute("title", column.meaning)
    return Markup('<th scope="col"{}>{}</th>').format(attributes, column.heading)


def _cell(column: Column[R], row: R, repeat_heads: bool) -> Markup:
    attributes = _attribute("class", column.css or "n" * column.figure)
    attributes += _attribute("data-head", column.heading * (column.figure and repeat_heads))
    attributes += Markup(' data-value="{}"').format(column.value(row)) if column.value is not None else ""
    content = column.html(row) if column.html is not None else column.text(row)
    return Markup("<td{}>{}</td>").format(attributes if content else _attribute("class", column.css), content)


def _attribute(name: str, value: str) -> Markup:
    return Markup(' {}="{}"').format(Markup(name), value) if value else Markup("")
