"""A table declared once: rendered for pages and terminals, as CSV and as Markdown.

A row type is a frozen dataclass with a field for each column, declared by `column`; `columns_of` makes the columns of
pages and terminals from it, `rows_as_csv` a file. Other rows have columns that are declared one by one.
"""

from __future__ import annotations

import csv
import io
import math
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, dataclass
from functools import singledispatch
from itertools import zip_longest
from operator import itemgetter
from typing import Any, Generic, TypeVar

from markupsafe import Markup

from ces_observer.errors import Suggesting
from ces_observer.fields import Field
from ces_observer.records import declare, record_fields
from ces_report.typesetting import Chart, Symbols, format_spread

R = TypeVar("R")
MAX_OPEN_ROWS = 20  # of a table that a page does not fold
WIDTH, MIN_TEXT = 100, 20  # characters of printed results, and of their wrapped texts
BAR = Markup(
    '<span class="figure">{}</span><span class="track"><span class="bar" style="width:{:.1f}%"></span>{}</span>'
)


@dataclass(frozen=True)
class Column(Generic[R]):
    """A column: its `heading`, the `text` of a row in it, and what it means.

    `figure` if it holds numbers. `small` is a remark, such as an interval: below the text on pages, else in brackets
    after it. On pages, `html` replaces the text (links, bars), `css` and `head_css` name the
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
    small: Callable[[R], str] | None = None

    def line(self, row: R) -> str:
        """Return the text of a row with its remark."""
        remark = self.small(row) if self.small is not None else ""
        return f"{self.text(row)} ({remark})" if remark else self.text(row)


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

    def folded(self, css: str = "plain", summary: str = "Table") -> Markup:
        """Return the table for a page, under a `summary` that opens it if it has more than MAX_OPEN_ROWS rows."""
        table = self.to_html(css, repeat_heads=False)
        if len(self.rows) <= MAX_OPEN_ROWS:
            return Markup('<div class="wide">{}</div>').format(table)
        text = f"{summary}, {len(self.rows)} rows"
        return Markup('<details class="wide"><summary>{}</summary>{}</details>').format(text, table)

    def to_markdown(self) -> str:
        """Return the table as Markdown, figures to the right."""
        rule = ["---:" if column.figure else "---" for column in self.columns]
        lines = [[column.heading for column in self.columns], rule]
        lines += [[column.line(row) for column in self.columns] for row in self.rows]
        return "\n".join(f"|{'|'.join(line)}|" for line in lines)

    def __str__(self) -> str:
        """Return the table as plain text, as a terminal of WIDTH shows it: the widest texts are wrapped."""
        shown = [column for column in self.columns if not column.page_only]
        lines = [[c.short or c.heading for c in shown], *([c.line(row) for c in shown] for row in self.rows)]
        cells = [[text.replace("\n", ", ") for text in line] for line in lines]
        widths = [max(map(len, texts)) for texts in zip(*cells, strict=True)]
        if shown and (excess := sum(widths) + 2 * (len(widths) - 1) - WIDTH) > 0:
            widest = max(range(len(widths)), key=lambda k: (not shown[k].figure, widths[k]))
            widths[widest] = max(widths[widest] - excess, MIN_TEXT)
        wrapped = [[wrap(text, width) for text, width in zip(line, widths, strict=True)] for line in cells]
        return "\n".join(
            "  ".join(
                text.rjust(width) if column.figure else text.ljust(width)
                for column, text, width in zip(shown, texts, widths, strict=True)
            ).rstrip()
            for line in wrapped
            for texts in zip_longest(*line, fillvalue="")
        )


def wrap(text: str, width: int = WIDTH) -> list[str]:
    """Return the lines of a text of at most this width; longer words stay whole."""
    return textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]


def text_table(
    heads: Sequence[str], rows: Iterable[Sequence[str]], title: str = "", left: int = 1, css: str = ""
) -> Table[Sequence[str]]:
    """Return a table whose rows are a text for each head, figures after the first `left`; cells before have `css`."""
    names = [Column[Sequence[str]](head, itemgetter(i), css=css) for i, head in enumerate(heads[:left])]
    figures = [Column[Sequence[str]](head, itemgetter(i), figure=True) for i, head in enumerate(heads[left:], left)]
    return Table([*names, *figures], list(rows), title)


@dataclass(frozen=True)
class Section:
    """A section of a report: an equation, a table, symbols with meanings, a note, charts; `ident` is its HTML id."""

    ident: str
    title: str
    table: Table[Any] = Table((), ())
    note: str = ""
    equation: Markup = Markup("")
    symbols: Symbols = ()
    charts: tuple[Chart, ...] = ()


class PrintedResult(Suggesting):
    """A result that prints itself in scripts and notebooks as a few lines and a table, see `summarize_result`."""

    def __repr__(self) -> str:
        texts, table = summarize_result(self)
        lines = [line for text in texts for line in wrap(text)]
        return "\n".join([*lines, str(table)] if table.rows else lines)

    def _repr_html_(self) -> str:
        lines, table = summarize_result(self)
        text = Markup("<br>").join(lines)
        return str(Markup("<p>{}</p>{}").format(text, table.to_html() if table.rows else ""))


class PrintedResults(PrintedResult, tuple[R, ...]):
    """Results in a row, printed in the same way; so is a part of them."""

    def __getitem__(self, key: Any) -> Any:
        part = super().__getitem__(key)
        return type(self)(part) if isinstance(key, slice) else part

    def _suggest(self, name: str) -> str:
        return f"; its results have, such as [0].{name}" if self and name in dir(self[0]) else super()._suggest(name)


@singledispatch
def summarize_result(result: object) -> tuple[Sequence[str], Table[Any]]:
    """Return what a result says in a few lines, and its table; rooms that have the words register theirs."""
    return [f"<{type(result).__name__}>"], Table((), ())


def parameter_section(
    about: str, heads: Sequence[str], rows: Iterable[Sequence[str]], symbols: Symbols = ()
) -> Section:
    """Return the section of a model's parameters: names, and columns of numbers, which `about` explains."""
    return Section("parameters", "Parameters", text_table(heads, rows, css="formula"), about, symbols=symbols)


@dataclass(frozen=True)
class RowField(Field):
    """A field of a row type: a value with a `heading` on pages and a `short` one in terminals; none is for files only.

    Numbers are shown with `digits` significant digits, with `milli` in thousandths of their unit. With `spread`, such
    as "sd", the field `force_sd_N` follows `force_N` after ±, and says how many digits count.
    """

    heading: str = ""
    short: str = ""
    digits: int = 3
    spread: str = ""
    milli: bool = False

    @property
    def column(self) -> Column[Any]:
        """The column of a table, with the unit in its headings."""
        unit = "" if self.unit == "1" else f"{'m' * self.milli}{self.unit}"
        heading, short = (f"{self.heading} [{unit}]", f"{self.short}\n{unit}") if unit else (self.heading, self.short)
        figure, page_only = self.kind is not str, not self.short
        return Column(heading, self.show, self.meaning, figure, short=short, page_only=page_only)

    def show(self, row: Any) -> str:
        """Return the text of the value in a row."""
        value, scale = getattr(row, self.name), 1e3 if self.milli else 1.0
        if not isinstance(value, float):
            return str(value)
        end = "" if self.unit == "1" else f"_{self.unit.replace('/', '_')}"
        spread = getattr(row, f"{self.name.removesuffix(end)}_{self.spread}{end}") if self.spread else math.nan
        return format_spread(scale * value, scale * spread, self.digits)


def column(unit: str, meaning: str, heading: str = "", short: str = "", **settings: Any) -> Any:
    """Declare a field of a row type: a number in `unit` ("1": a plain one), and how it is shown; see RowField."""
    return declare(RowField(default=math.nan, unit=unit, meaning=meaning, heading=heading, short=short, **settings))


def whole(meaning: str, heading: str = "", short: str = "") -> Any:
    """Declare a field of a row type: a whole number."""
    return declare(RowField(default=0, unit="1", meaning=meaning, heading=heading, short=short))


def words(meaning: str, heading: str = "", short: str = "") -> Any:
    """Declare a field of a row type: a text."""
    return declare(RowField(default="", meaning=meaning, heading=heading, short=short))


def row_fields(row: Any) -> dict[str, RowField]:
    """Return the fields of a row type by name."""
    return {name: field for name, field in record_fields(row).items() if isinstance(field, RowField)}


def columns_of(row: Any, *names: str) -> list[Column[Any]]:
    """Return the columns of these fields of a row type, in this order; without names, of all that have a heading."""
    fields = row_fields(row)
    return [fields[name].column for name in names or fields if fields[name].heading]


def rows_as_csv(row: Any, rows: Iterable[Any]) -> str:
    """Return rows as CSV text below the names of all fields; numbers have seven figures, NaN is an empty cell."""

    def cell(value: object) -> object:
        if not isinstance(value, float):
            return value
        return "" if math.isnan(value) else f"{value:.7g}"

    return as_csv([row_fields(row), *(map(cell, astuple(one)) for one in rows)])


def as_csv(lines: Iterable[Iterable[object]]) -> str:
    """Return lines of cells as CSV text."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()


def _head(column: Column[R]) -> Markup:
    classes = " ".join(filter(None, ["n" * column.figure, column.head_css]))
    attributes = _attribute("class", classes) + _attribute("title", column.meaning)
    return Markup('<th scope="col"{}>{}</th>').format(attributes, column.heading)


def _cell(column: Column[R], row: R, repeat_heads: bool) -> Markup:
    attributes = _attribute("class", column.css or "n" * column.figure)
    attributes += _attribute("data-head", column.heading * (column.figure and repeat_heads))
    attributes += Markup(' data-value="{}"').format(column.value(row)) if column.value is not None else ""
    content = column.html(row) if column.html is not None else column.text(row)
    if column.small is not None and (remark := column.small(row)):
        content = Markup("{}<small>{}</small>").format(content, remark)
    return Markup("<td{}>{}</td>").format(attributes if content else _attribute("class", column.css), content)


def _attribute(name: str, value: str) -> Markup:
    return Markup(' {}="{}"').format(Markup(name), value) if value else Markup("")
