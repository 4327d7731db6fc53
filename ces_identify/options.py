"""The options of an identification, each declared once.

The program `ces identify`, the node `identify`, campaigns and the plans of iterations take names, ranges, defaults and
meanings from here; the sizes of a structure are declared in its kit.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from ces_data.reading import kind_of
from ces_identify.numerics.search import GAUSS_NEWTON, METHODS, Limits
from ces_identify.polynomial.rules_file import load_rules
from ces_identify.prepare.cost import FORMS, parse_weighting
from ces_identify.prepare.sampling import SPEEDS
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO, BestStructure, default_sizes
from ces_identify.structures.kit import Fitter, IdentifyOptions, Size
from ces_observer.errors import CesError
from ces_observer.model import MAX_DELAY_S
from ces_observer.options import Option, in_group

FROM_DATA = "from the data"
REGIONS = f"{FORMS} [m/s, share of the stroke, A, m]"
POLYNOMIAL_STRUCTURES = ("polynomial", AUTO)
POLYNOMIALS = f"polynomials (--structure polynomial or {AUTO})"

TIME = Option(
    "time",
    None,
    "hard end in time, from reading to report, without the compilation in the first run; a search that it ends may "
    "answer differently on another machine",
    0.1,
    1e6,
    "s",
    kind=float,
    none="none: the search ends by its amount of work",
    metavar="S",
)
STARTS = Option("starts", 8, "random starts; fewer in recordings of more than 100,000 ticks", 1, 10000, metavar="N")
SEED = Option("seed", 1, "seed of the first start", 0, 2**31, metavar="N")
TARGET = Option("target", 0.0, "cost at which the search stops", 0.0, 100.0, "%", metavar="J")
THREADS = Option("threads", None, "threads of the search", 1, 256, kind=int, none="one for each processor", metavar="N")
CERTIFICATE = Option(
    "certificate", True, "require a proof of the model's stability, without which the observer refuses it"
)
FORGET = Option(
    "forget",
    5.0,
    "time in which the model forgets where it was started, to 1 %; less than 2 s costs accuracy",
    0.1,
    60.0,
    "s",
    metavar="S",
)
BAND = Option("band", True, "fit a band: how far the measured force may lie from the estimate (less than a second)")

METHOD = Option(
    "method",
    GAUSS_NEWTON,
    "search method: Gauss-Newton selection; thesis: the procedure and the candidates of the thesis to the letter, for "
    "comparison, where nothing keeps a model stable",
    choices=METHODS,
)
TERMS = Option(
    "terms", None, "maximum number of terms", 1, 200, kind=int, none="25, or no limit with method thesis", metavar="N"
)
CANDIDATES = Option(
    "candidates",
    None,
    "file of candidate rules (YAML), as --show-candidates prints",
    kind=Path,
    none="the built-in ones of the method",
    metavar="FILE",
)
BLEND = Option(
    "blend",
    (),
    "divide the terms into sub-models, one for each of these values of a signal, with blending in between, such as "
    "speed:-0.3,0.3; SIGNAL is position, speed, current or a constructed input such as valve",
    metavar="SIGNAL:A,B,...",
)

SPLIT = Option(
    "split",
    None,
    "first share of each recording to identify on; the rest is for validation",
    0.05,
    1.0,
    kind=float,
    none="0.75, or 1 with validation recordings",
    metavar="SHARE",
)
SPEED = Option(
    "speed",
    None,
    "speed of the model: differentiated from the position, or measured, too, which the vehicle must have then",
    choices=SPEEDS,
    none="measured if the signals file describes it, or if the log had no position",
)
WEIGHT = Option(
    "weight", (), f"give ticks in this region W times the weight in fit and selection: {REGIONS}", metavar="REGION=W"
)
RATE = Option("rate", None, "rate of the model", 1.0, 1e5, "Hz", kind=float, none=FROM_DATA, metavar="HZ")
DELAY = Option(
    "delay",
    0.0,
    "how long after a sample its force is estimated, whole ticks up to 0.02 s: the speed is known better then",
    0.0,
    MAX_DELAY_S,
    "s",
    metavar="S",
)
TEACHER = Option("teacher", None, "simulation whose force to learn instead of the measured force", metavar="SIM")
IGNORE_FINDINGS = Option(
    "ignore_findings", False, "identify in spite of findings that make a wrong model; model.json lists them"
)


def structure_option() -> Option:
    """Return the option that chooses the structure of the model."""
    about = ", ".join(f"{name}: {kit.about}" for name, kit in KITS.items())
    text = f"{about}; {AUTO}: the best of several, or a mean of them"
    return Option("structure", next(iter(KITS)), text, choices=(*KITS, AUTO))


def list_options() -> tuple[Option, ...]:
    """Return all options besides the files that go in and out, in the order of the help."""
    sizes = (size for kit in KITS.values() for size in kit.sizes)
    return (
        structure_option(),
        TIME,
        *in_group("search", STARTS, SEED, TARGET, THREADS, CERTIFICATE, FORGET, BAND),
        *in_group(POLYNOMIALS, METHOD, TERMS, CANDIDATES, BLEND),
        *in_group("sizes of other structures", *sizes),
        *in_group("data", SPLIT, SPEED, WEIGHT, RATE, DELAY, TEACHER, IGNORE_FINDINGS),
    )


def build_identify_options(values: Mapping[str, Any]) -> IdentifyOptions:
    """Return the settings of an identification for values by the names of options; it leaves out other names."""
    given = {name: value for name, value in values.items() if name != TIME.name or value is not None}
    limits = Limits(**{f.name: given[f.name] for f in fields(Limits) if f.name in given})
    own = {f.name: values[f.name] for f in fields(IdentifyOptions) if f.name in values}
    return IdentifyOptions(**{**own, "limits": limits})


def choose_fit(structure: str, given: Mapping[str, Any]) -> tuple[IdentifyOptions, Fitter]:
    """Return the settings of an identification and the fitter of a structure, for values by the names of options.

    Weights and candidate rules may be texts. Raises CesError naming what is unknown, or does not apply.
    """
    values = {name: value for name, value in given.items() if value is not None}
    sizes = {name: value for name, value in values.items() if name not in _OPTION_NAMES and name not in _LIMIT_NAMES}
    fitter = _find_fitter(structure, sizes)
    named = {name: value for name, value in values.items() if name not in sizes}
    if structure not in POLYNOMIAL_STRUCTURES:
        for option in (METHOD, TERMS, CANDIDATES):
            if option.name in named:
                raise CesError(f"{option.name}: does not apply to structure '{structure}', only to {POLYNOMIALS}")
    return _with_options(IdentifyOptions(), named), fitter


_LIMIT_NAMES = {field.name for field in fields(Limits)}
_OPTION_NAMES = {field.name for field in fields(IdentifyOptions)} - {"limits"}
_OBJECTS = ("weight", "candidates")  # options that may be texts or objects


def _with_options(options: IdentifyOptions, named: Mapping[str, Any]) -> IdentifyOptions:
    """Return the options with the values that were given by name; weights and candidate rules may be texts.

    None leaves a value as it is.
    """
    if not isinstance(options, IdentifyOptions):
        raise CesError(f"options: expected IdentifyOptions; got {kind_of(options)}")
    values = {name: value for name, value in named.items() if value is not None}
    for option in list_options():
        if option.name in values and option.name not in _OBJECTS:
            option.check(values[option.name])
    if isinstance(weight := values.get("weight"), str | Sequence):
        values["weight"] = parse_weighting([weight] if isinstance(weight, str) else weight)
    if isinstance(rules := values.get("candidates"), str | os.PathLike):
        values["candidates"] = load_rules(Path(rules), values.get("method", options.limits.method))
    limits = {name: value for name, value in values.items() if name in _LIMIT_NAMES}
    own = {name: value for name, value in values.items() if name not in _LIMIT_NAMES}
    return replace(options, limits=replace(options.limits, **limits), **own)


def _find_fitter(structure: str, sizes: Mapping[str, Size]) -> Fitter:
    """Return the fitter of a structure with the given sizes; raises CesError naming what is unknown."""
    if structure != AUTO and structure not in KITS:
        raise CesError(f"structure '{structure}' is unknown; expected one of {', '.join([*KITS, AUTO])}")
    defaults = default_sizes() if structure == AUTO else {size.name: size.default for size in KITS[structure].sizes}
    if not sizes.keys() <= defaults.keys():
        raise CesError(f"structure '{structure}' has no size {', '.join(sizes.keys() - defaults.keys())}")
    try:
        return (
            BestStructure({**defaults, **sizes}) if structure == AUTO else KITS[structure].fitter({**defaults, **sizes})
        )
    except ValueError as error:
        raise CesError(f"structure '{structure}': {error}") from None
