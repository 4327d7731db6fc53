"""The options of an identification, each declared once.

The program `ces identify`, the node `identify`, campaigns and the plans of iterations take names, ranges, defaults and
meanings from here; the sizes of a structure are declared in its kit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from ces_identify.numerics.search import GAUSS_NEWTON, METHODS, Limits
from ces_identify.prepare.cost import FORMS
from ces_identify.prepare.sampling import SPEEDS
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO
from ces_identify.structures.kit import IdentifyOptions
from ces_observer.limits import FileLimits
from ces_observer.options import Option, in_group

FROM_DATA = "from the data"
REGIONS = f"{FORMS} [m/s, share of the stroke, A, m]"
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
    FileLimits.MAX_DELAY_S,
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
