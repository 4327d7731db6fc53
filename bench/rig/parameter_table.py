"""The damper's parameters as a commented YAML file or a Markdown table, from the declarations in `parameters.py`.

python -m bench.rig.parameter_table yaml > ces_rig/dampers/hydraulic/damper.yaml
python -m bench.rig.parameter_table markdown
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

from ces_rig.dampers.hydraulic.parameters import Damper

HEADER = """\
# yaml-language-server: $schema=../../../ces_identify/schemas/damper.json
# The virtual rig's damper with its default parameters. Copy, keep what you change, and name the copy in an experiment:
#   damper: my_damper.yaml
# or write the changed values into the experiment itself:  damper: {seal: {coulomb_N: 40.0}}
# Units are in brackets, then the accepted range. Pressures are absolute; areas include the discharge coefficient.
"""


@dataclass(frozen=True)
class ParameterRow:
    """One parameter: its path, its default and its declaration."""

    path: tuple[str, ...]
    value: float
    unit: str
    what: str
    low: float
    high: float


def rows(part: Any = None, path: tuple[str, ...] = ()) -> Iterator[ParameterRow]:
    """Yield the parameters of `part` (default: the default damper), section by section."""
    part = Damper() if part is None else part
    for f in fields(part):
        value, here = getattr(part, f.name), (*path, f.name)
        if is_dataclass(value):
            yield from rows(value, here)
        else:
            yield ParameterRow(
                here, value, f.metadata["unit"], f.metadata["what"], f.metadata["low"], f.metadata["high"]
            )


def as_yaml() -> str:
    """Return the default damper as a commented YAML file."""
    lines, open_sections = [HEADER], ()
    for row in rows():
        for depth, section in enumerate(row.path[:-1]):
            if open_sections[: depth + 1] != row.path[: depth + 1]:
                lines.append(f"{'  ' * depth}{section}:\n")
        open_sections = row.path[:-1]  # type: ignore[assignment]
        entry = f"{'  ' * len(open_sections)}{row.path[-1]}: {format_number(row.value)}"
        lines.append(f"{entry:<42}# [{row.unit}] {row.what}; {row.low:g} to {row.high:g}\n")
    return "".join(lines)


def as_markdown() -> str:
    """Return the table of parameters for the documentation."""
    lines = ["| parameter | default | unit | what it is |", "|---|---:|---|---|"]
    lines += [f"| `{'.'.join(r.path)}` | {r.value:g} | {r.unit} | {r.what} |" for r in rows()]
    return "\n".join(lines) + "\n"


def format_number(value: float) -> str:
    """Return a number that YAML 1.1 reads as one: the mantissa keeps its point."""
    text = f"{value:g}"
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{e}{exponent}"


if __name__ == "__main__":
    sys.stdout.write(as_yaml() if sys.argv[1:] == ["yaml"] else as_markdown())
