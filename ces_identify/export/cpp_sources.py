"""What the C++ package `ces_observer_cpp` takes from the Python source when it is built, so that both say the same.

    python3 -m ces_identify.export.cpp_sources FOLDER

writes the core (`ces_core.c`, `ces_core.h`), the counts of arrivals (`ces_arrivals.c`, `ces_arrivals.h`), the node's
parameters for generate_parameter_library (`parameters.yaml`) and reasons in words (`from_python.hpp`). It needs the
standard library only.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

from ces_identify.export.c_expressions import SubsetError
from ces_identify.export.c_printer import Core, read_core
from ces_observer import damper_observer, reasons
from ces_observer.core import SEEDS, tick_digest
from ces_observer.errors import CesError, ModelError
from ces_observer.health import arrivals, diagnostics
from ces_observer.limits import ClockLimits, HealthLimits, NumberLimits
from ces_observer.nodes.parameter_table import (
    IN_USE,
    NAME,
    OF_A_DAMPER,
    OF_THE_NODE,
    signal_options,
    type_name,
)
from ces_observer.options import Option
from ces_observer.signals import DEFAULTS, MOTIONS, NUMBERS
from ces_observer.tick.run import rounding_sample

TYPES = {"integer": "int", "integer_array": "int_array"}  # by ROS's name, where the library has another
PYTHON_ONLY = ("executor", "force", "snapshot_service", "snapshot_after_s", "cost_warn_J", "cost_window_s")
MEANINGS = {
    "model": "absolute path of the flat file from `ces export model.json --out NAME.ces`; a new path is checked and "
    "loaded while running",
    "name": "joint name in the estimate; empty: the one in position.field, else 'damper'",
}  # of parameters that differ here from the Python node's
CONSTANT = "current.constant"  # which may be not set, so that the node declares it by hand
NOT_MEASURED = {"topic": "", "type": "", "field": ""}
ARRIVALS = ("losses_take_number", "arrivals_reset", "arrivals_take", "arrivals_roll", "arrivals_restart_ages")
NODE_REASONS = ("SILENT", "POSITION_NOT_FINITE", "NO_CURRENT", "NO_MOTION", "OFF_CLOCK")
WORDS = """// Printed by ces_identify.export.cpp_sources from ces_observer: the words of /diagnostics, and limits.
#pragma once

#include <array>
#include <cstddef>

namespace ces
{{

constexpr const char * CORE_DIGEST = "{digest}";
constexpr double ROUNDED[] = {{{rounded}}};  // ces_rounding_sample(1) and so on
constexpr double LARGEST = {largest!r};  // of a scale, offset or constant, either way
constexpr const char * PYTHON_ONLY[] = {{{others}}};  // parameters
constexpr const char * IDLE_ONLY[] = {{{idle}}};  // parameters that cannot be set because
constexpr const char * IN_USE = "{in_use}";

// Why a force is published or withheld; the first are those of the core, in its order.
enum Reason : std::size_t {{{names}}};

constexpr std::array<const char *, {count}> REASON_TEXTS{{
  {texts}}};

constexpr const char * text_of(Reason reason) {{return REASON_TEXTS[reason];}}

constexpr Reason ERRORS[] = {{{errors}}};  // others are warnings

// A value of /diagnostics: its key, with {{}} for a name, and the form of its value.
struct Figure
{{
  const char * key, * form;
}};

namespace figures
{{
{figures}
}}  // namespace figures

namespace remarks
{{
{remarks}
}}  // namespace remarks

namespace limits
{{
{limits}
}}  // namespace limits

}}  // namespace ces
"""
LIMITS = (
    ("OUTSIDE", HealthLimits.OUTSIDE),
    ("DROPPED", HealthLimits.DROPPED),
    ("AHEAD_S", ClockLimits.AHEAD_S),
    ("OFFSET_S", ClockLimits.OFFSET_S),
    ("LATE_S", ClockLimits.LATE_S),
)


def write_sources(folder: Path) -> None:
    """Write all files into a folder, those that are the same not again, or they would be compiled again."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in print_sources().items():
        path = folder / name
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def print_sources() -> dict[str, str]:
    """Return the text of each file by its name."""
    counts = Path(arrivals.__file__).read_text(encoding="utf-8")
    core = Core({"arrivals": counts}, ARRIVALS, "ces_observer/health")
    files = {"ces_arrivals.h": core.header, "ces_arrivals.c": core.source}
    return {
        "ces_core.h": read_core().header,
        "ces_core.c": read_core().source,
        **{
            n: text.replace("CES_", "CES_ARRIVALS_").replace("ces_core.h", "ces_arrivals.h")
            for n, text in files.items()
        },
        "parameters.yaml": parameter_library("observer", list_parameters()),
        "from_python.hpp": reason_header(),
    }


def list_parameters() -> list[Option]:
    """Return the parameters of the Python node that the C++ node has, too, and those of its signals."""
    common = [option for option in (*OF_THE_NODE, *OF_A_DAMPER, NAME) if option.name not in PYTHON_ONLY]
    listed = [replace(option, meaning=MEANINGS.get(option.name, option.meaning)) for option in common]
    for signal in ("position", "current", *MOTIONS):
        listed += signal_options(signal, DEFAULTS.get(signal, NOT_MEASURED) | NUMBERS)
    return [option for option in listed if option.name != CONSTANT]


def parameter_library(name: str, options: Iterable[Option]) -> str:
    """Return parameters.yaml for generate_parameter_library, which declares the `options` in the C++ namespace `name`.

    Ranges are checked by the validator `ces::within`, whose words are those of the Python node.
    Raises ModelError for a text that cannot be printed.
    """
    tree: dict[str, Any] = {}
    for option in options:
        place = tree
        *groups, last = option.name.split(".")
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = _declaration(option)
    return _as_yaml({name: tree})


def reason_header() -> str:
    """Return from_python.hpp."""
    names = {text: name for name, text in vars(reasons).items() if isinstance(text, str) and name.isupper()}
    names |= {getattr(damper_observer, name): name for name in NODE_REASONS}
    texts = [*reasons.REASONS, *(getattr(damper_observer, name) for name in NODE_REASONS)]
    idle = [option.name for option in list_parameters() if not option.live]
    return WORDS.format(
        digest=tick_digest(),
        rounded=", ".join(rounding_sample(seed).hex() for seed in SEEDS),
        largest=NumberLimits.MAX_COEFFICIENT,
        others=", ".join(f'"{name}"' for name in PYTHON_ONLY),
        idle=", ".join(f'"{name}"' for name in (*idle, CONSTANT)),
        in_use=_literal(IN_USE),
        names=", ".join([*(names[text] for text in reasons.REASONS), *NODE_REASONS]),
        count=len(texts),
        texts=",\n  ".join(f'"{_literal(text)}"' for text in texts),
        errors=", ".join(f"Reason::{names[text]}" for text in diagnostics.ERRORS),
        figures="\n".join(
            f'constexpr Figure {name}{{"{_literal(figure.key)}", "{_literal(figure.form)}"}};'
            for name, figure in vars(diagnostics.Figures).items()
            if isinstance(figure, diagnostics.Figure)
        ),
        remarks="\n".join(
            f'constexpr const char * {name} = "{_literal(text)}";'
            for name, text in vars(diagnostics.Remarks).items()
            if name.isupper()
        ),
        limits="\n".join(f"constexpr double {name} = {value!r};" for name, value in LIMITS),
    )


def _as_yaml(value: Any, indent: str = "\n") -> str:
    """Return a value in YAML 1.1, in which a float has a point, unlike JSON's 1e+30."""
    if isinstance(value, dict):
        return "".join(f"{indent}{json.dumps(key)}: {_as_yaml(item, indent + '  ')}" for key, item in value.items())
    if isinstance(value, list):
        return f"[{', '.join(map(_as_yaml, value))}]"
    text = json.dumps(value, ensure_ascii=False, allow_nan=False)
    return text.replace("e", ".0e") if isinstance(value, float) and "." not in text else text


def _literal(text: str) -> str:
    """Return a text as it stands between quotes in C++. Raises ModelError for what cannot be printed."""
    if not text.isprintable():
        raise ModelError(f"{text!r}: expected printable characters")
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _declaration(option: Option) -> dict[str, Any]:
    """Return the declaration of one parameter; the library writes texts into C++ as they are."""
    kind = type_name(option).lower()
    declared: dict[str, Any] = {"type": TYPES.get(kind, kind)}
    if option.default is not None:
        default = option.default
        declared["default_value"] = _literal(default) if isinstance(default, str) else default
    declared["description"] = option.described.replace('"', "'")
    if option.kind in (int, float) and isfinite(option.high):
        declared["additional_constraints"] = option.expected
        declared["validation"] = {"ces::within<>": [option.kind(option.low), option.kind(option.high)]}
    return declared


def main() -> int:
    """Write all files into the folder named on the command line; returns the exit status."""
    try:
        write_sources(Path(sys.argv[1]))
        return 0
    except (CesError, SubsetError, OSError) as error:
        print(error, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
