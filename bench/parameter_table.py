"""The damper's parameters as a commented YAML file, from the declarations in `parameters.py`.

python -m bench.parameter_table > ces_rig/dampers/hydraulic/damper.yaml
"""

from __future__ import annotations

import sys

from ces_observer.fields import Field
from ces_observer.records import walk_record
from ces_rig.dampers.hydraulic.parameters import Damper

HEADER = """\
# yaml-language-server: $schema=../../../ces_identify/schemas/damper.json
# The virtual rig's damper with its default parameters. Copy, keep what you change, and name the copy in an experiment:
#   damper: my_damper.yaml
# or write the changed values into the experiment itself:  damper: {seal: {coulomb_N: 40.0}}
# Units are in brackets, then the accepted range. Pressures are absolute; areas include the discharge coefficient.
"""


def rows() -> list[tuple[str, float, Field]]:
    """Return path, default and field of each parameter of the default damper, section by section."""
    return list(walk_record(Damper()))


def as_yaml() -> str:
    """Return the default damper as a commented YAML file."""
    lines: list[str] = [HEADER]
    open_sections: list[str] = []
    for path, value, one in rows():
        *sections, name = path.split(".")
        for depth, section in enumerate(sections):
            if open_sections[: depth + 1] != sections[: depth + 1]:
                lines.append(f"{'  ' * depth}{section}:\n")
        open_sections = sections
        entry = f"{'  ' * len(sections)}{name}: {format_number(value)}"
        lines.append(f"{entry:<42}# [{one.unit}] {one.meaning}; {one.low:g} to {one.high:g}\n")
    return "".join(lines)


def format_number(value: float) -> str:
    """Return a number that YAML 1.1 reads as one: the mantissa keeps its point."""
    text = f"{value:g}"
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{e}{exponent}"


if __name__ == "__main__":
    sys.stdout.write(as_yaml())
