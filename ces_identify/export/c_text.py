"""Comments, docstrings and line breaks of the C that `c_printer` writes: they stand where they do in the source."""

from __future__ import annotations

import io
import re
import textwrap
import tokenize
from typing import NamedTuple

WIDTH = 120
INDENT = "    "
FOR_TOOLS = ("noqa", "type:", "fmt:", "pragma", "ruff:", "mypy:")  # comments that say nothing to a reader


class Comment(NamedTuple):
    """A comment of the source; `alone` if nothing else is on its line."""

    line: int
    column: int
    text: str
    alone: bool


class Comments:
    """The comments of a module, taken in their order as its statements are printed."""

    def __init__(self, source: str) -> None:
        tokens = tokenize.generate_tokens(io.StringIO(source).readline)
        self.waiting = [
            Comment(token.start[0], token.start[1], text, not token.line[: token.start[1]].strip())
            for token in tokens
            if token.type == tokenize.COMMENT
            if (text := token.string.lstrip("# ").rstrip("\\ ")) and not text.startswith(FOR_TOOLS)
        ]

    def before(self, line: int, column: int = 0) -> list[str]:
        """Take the comments above a line that are indented at least as far as `column`."""
        end = 0
        while end < len(self.waiting) and self.waiting[end].line < line and self.waiting[end].column >= column:
            end += 1
        taken, self.waiting = self.waiting[:end], self.waiting[end:]
        return [f"// {comment.text}" for comment in taken]

    def beside(self, first: int, last: int) -> str:
        """Take what is said at the ends of lines, as the end of one line; comments between them wait."""
        said = [comment for comment in self.waiting if first <= comment.line <= last and not comment.alone]
        self.waiting = [comment for comment in self.waiting if comment not in said]
        return "".join(f"  // {comment.text}" for comment in said[:1]) + "".join(f" {c.text}" for c in said[1:])


def block_comment(text: str, title: str = "") -> list[str]:
    """Return a docstring as a comment of C; nothing for none."""
    lines = text.replace("*/", "* /").replace("/*", "/ *").splitlines()
    lines = [*([title, ""] if title else []), *lines]
    if len(lines) < 2:
        return [f"/* {line} */" for line in lines]
    return [f"/* {lines[0]}", *(f" * {line}".rstrip() for line in lines[1:]), " */"]


def _bind_words(code: str) -> str:
    """Return code with a NUL for each space at which a line is better not broken."""
    code = re.sub(r"\b(const|double|int64_t|bool|void|static|return) ", "\\1\0", code)
    code = re.sub(r" ([*/%]) ", "\0\\1\0", re.sub(r" (\S{1,2}) (?=\S)", " \\1\0", code))
    depth, bound = 0, []
    for letter in code:
        depth += (letter == "[") - (letter == "]")
        bound.append("\0" if letter == " " and depth else letter)
    return "".join(bound)


def wrap(line: str, depth: int) -> list[str]:
    """Return a line of code, and the comment at its end, as lines that are not too long."""
    code, mark, comment = line.partition("  // ")
    room = WIDTH - len(INDENT) * depth
    lines = textwrap.wrap(
        _bind_words(code), room, subsequent_indent=INDENT, break_long_words=False, break_on_hyphens=False
    )
    lines = [text.replace("\0", " ") for text in lines]
    if mark and len(lines[-1]) + len(comment) + 5 <= room:
        lines[-1] += mark + comment
    elif mark:
        lines[:0] = [f"// {text}" for text in textwrap.wrap(comment, room - 3, break_on_hyphens=False)]
    return [INDENT * depth + text for text in lines]
