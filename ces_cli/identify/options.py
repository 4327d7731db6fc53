"""The parameters of the node `identify`, as a table without ROS: the options of `ces identify` under the same names.

The node declares them, `build_command_line` turns their values into the program's command line, and the tests compare
names, defaults and ranges with the program's own parser.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ces_identify.polynomial.search_limits import BOTH, METHODS
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO
from ces_observer.errors import CesError
from ces_observer.model import DIFFERENTIATORS
from ces_observer.nodes.parameter_table import NO_WORDS, ParameterSpec, Value


@dataclass(frozen=True)
class Option(ParameterSpec):
    """An option of the program as a parameter; `unset` is the number that selects the program's own default."""

    unset: float | None = None
    is_path: bool = False


PARAMETERS = (
    Option("bags", NO_WORDS, "recordings with a measured force; at least one must be given", is_path=True),
    Option("validate", NO_WORDS, "recordings for validation only", is_path=True),
    Option("signals", "", "signals file; empty: the packaged one", is_path=True),
    Option("out", "model.json", "model file to write; its folder must exist", is_path=True),
    Option("report", "", "report page to write (HTML); empty: none", is_path=True),
    Option("structure", next(iter(KITS)), "structure of the model", one_of=(*KITS, AUTO)),
    *(Option(s.name, s.default, s.meaning, *(s.whole or ())) for kit in KITS.values() for s in kit.sizes),
    Option("split", 0.0, "first share of each recording to identify on; 0: 0.75, or 1 with validate", 0, 1, unset=0),
    Option("teacher", "", "simulation whose force replaces the measured force; empty: none"),
    Option("candidates", "", "file of candidate rules; empty: the built-in ones of the method", is_path=True),
    Option("construct", NO_WORDS, "constructed inputs for terms to use, such as hysteresis:0.001"),
    Option("blend", NO_WORDS, "sub-models with blending between values of a signal, such as speed:-0.3,0.3"),
    Option("method", BOTH, "search method", one_of=METHODS),
    Option("weight", NO_WORDS, "regions with more weight, each as REGION=W"),
    Option("terms", 0, "maximum number of terms; 0: 25, or no limit with method thesis", 0, 200, unset=0),
    Option("time", 60.0, "maximum time of the search [s]", 0.1, 1e6),
    Option("target", 0.0, "cost at which the search stops [%]", 0, 100),
    Option("starts", 8, "starts of the search", 1, 10000),
    Option("seed", 1, "seed of the first start", 0, 2**31),
    Option("threads", 0, "threads of the search; 0: one per processor", 0, 256, unset=0),
    Option("no_certificate", False, "also accept models whose stability is not proved (unsafe)"),
    Option("no_band", False, "fit no band around the force"),
    Option("force", False, "identify in spite of findings that make a wrong model"),
    Option("rate", 0.0, "rate of the model [Hz], at least 1; 0: from the data", 0, 1e5, unset=0),
    Option("bandwidth", 0.0, "bandwidth of the differentiator [Hz], at least 0.01; 0: from the data", 0, 5e4, unset=0),
    Option("differentiator", "auto", "source of the speed", one_of=("auto", *DIFFERENTIATORS)),
)
EXIT_WHEN_DONE = ParameterSpec("exit_when_done", False, "end after publishing the model")


def build_command_line(values: Mapping[str, Value]) -> list[str]:
    """Return the command line of `ces identify` for these parameter values; raises CesError naming the parameter."""
    texts_by_name = {parameter.name: _texts(parameter, values[parameter.name]) for parameter in PARAMETERS}
    bags = texts_by_name.pop("bags")
    if not bags:
        raise CesError(
            "parameter 'bags' is not set; set it to the paths of recordings: -p bags:='[bags/noise, bags/sweep]'"
        )
    validate = texts_by_name.pop("validate")
    words = [f"--{name.replace('_', '-')}{text}" for name, texts in texts_by_name.items() for text in texts]
    return [*words, *(["--validate", *validate] if validate else []), "--", *bags]


def _texts(parameter: Option, value: Value) -> list[str]:
    """Return the text after the option's name for each time it appears; nothing if it is left out."""
    if isinstance(value, bool):
        return [""] if value else []
    if isinstance(value, list):
        texts = [_text(parameter, one) for one in value if one]
        return texts if parameter.name in ("bags", "validate") else [f"={text}" for text in texts]
    if value == "" or (parameter.unset is not None and value == parameter.unset):
        return []
    return [f"={_text(parameter, value)}"]


def _text(parameter: Option, value: float | str) -> str:
    if isinstance(value, float):
        return f"{value:.17g}"
    return str(Path(value).expanduser()) if parameter.is_path else str(value)
