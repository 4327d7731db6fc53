"""Comments, docstrings and line breaks of the C that `c_printer` writes: they stand where they do in the source."""

from __future__ import annotations

import io
import re
import textwrap
import tokenize

WIDTH = 120
INDENT = "    "
FOR_TOOLS = ("noqa", "type:", "fmt:", "pragma", "ruff:", "mypy:")  # comments that say nothing to a reader


class Comments:
    """The comments of a module, taken in their order as its statements are printed."""

    def __init__(self, source: str) -> None:
        tokens = tokenize.generate_tokens(io.StringIO(source).readline)
        said = [(token.start[0], token.string.lstrip("# ")) for token in tokens if token.type == tokenize.COMMENT]
        self.waiting = [(line, text) for line, text in said if not text.startswith(FOR_TOOLS)]

    def take(self, last: int) -> list[str]:
        """Take all comments up to a line of the source that are not taken yet."""
        taken = [text for line, text in self.waiting if line <= last]
        self.waiting = self.waiting[len(taken) :]
        return taken

    def above(self, line: int, depth: int = 0) -> list[str]:
        """Take those above a line, as lines of C."""
        return [f"{INDENT * depth}// {text}" for text in self.take(line - 1)]


def block_comment(text: str, title: str = "") -> list[str]:
    """Return a docstring as a comment of C; nothing for none."""
    lines = text.replace("*/", "* /").replace("/*", "/ *").splitlines()
    lines = [*([title, ""] if title else []), *lines]
    if len(lines) < 2:
        return [f"/* {line} */" for line in lines]
    return [f"/* {lines[0]}", *(f" * {line}".rstrip() for line in lines[1:]), " */"]


def wrap(code: str, depth: int = 0, comment: str = "") -> list[str]:
    """Return code as lines that are not too long, with a comment at the end, or above if there is no room."""
    room = WIDTH - len(INDENT) * depth
    bound = re.sub(r"\b(const|double|int64_t|bool|[=*]) ", "\\1\0", code)  # a NUL is a space that is not broken
    lines = textwrap.wrap(bound, room, subsequent_indent=INDENT, break_long_words=False, break_on_hyphens=False)
    lines = [line.replace("\0", " ") for line in lines]
    if comment and len(lines[-1]) + len(comment) + 5 <= room:
        lines[-1] += f"  // {comment}"
    elif comment:
        lines[:0] = [f"// {text}" for text in textwrap.wrap(comment, room - 3, break_on_hyphens=False)]
    return [INDENT * depth + line for line in lines]
