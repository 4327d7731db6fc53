"""The options of an identification, each declared once, and the request that they make.

The program `ces identify`, the node `identify`, scripts, campaigns and the plans of iterations take names, ranges,
defaults and meanings from here; the sizes of a structure are declared in its kit.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import reduce
from math import inf
from pathlib import Path
from typing import Any

from ces_identify.numerics.search import GAUSS_NEWTON, METHODS, Limits
from ces_identify.polynomial.candidate_rules import CandidateRules
from ces_identify.polynomial.constructed import add_blend
from ces_identify.polynomial.rules_file import load_rules
from ces_identify.prepare.cost import FORMS, Weighting, parse_weighting
from ces_identify.prepare.sampling import SPEEDS
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO, BestStructure, default_sizes
from ces_identify.structures.kit import Fitter, IdentifyOptions, Size
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_observer.errors import CesError, OptionName, suggest
from ces_observer.fields import FieldError
from ces_observer.limits import FileLimits
from ces_observer.options import Option, in_group

STRUCTURE = "structure"
FROM_DATA = "from the data"
REGIONS = f"{FORMS} [m/s, share of the stroke, A, m]"
POLYNOMIALS = f"polynomials (--structure polynomial or {AUTO})"

TIME = Option(
    "time",
    None,
    "hard end in time, from start to report, without the compilation in the first run; a search that it ends may "
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
    return Option(STRUCTURE, next(iter(KITS)), text, choices=(*KITS, AUTO))


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


@dataclass(frozen=True)
class IdentifyRequest:
    """What model to identify: the options of `ces identify` by their names, with the sizes of structures in `sizes`.

    `candidates` and `weight` may be what they stand for, too. It is what the command line, the node, scripts, campaigns
    and plans of iterations make of what they are given.
    """

    structure: str = next(iter(KITS))
    time: float | None = TIME.default
    starts: int = STARTS.default
    seed: int = SEED.default
    target: float = TARGET.default
    threads: int | None = THREADS.default
    certificate: bool = CERTIFICATE.default
    forget: float = FORGET.default
    band: bool = BAND.default
    method: str = METHOD.default
    terms: int | None = TERMS.default
    candidates: Path | CandidateRules | None = CANDIDATES.default
    blend: tuple[str, ...] = BLEND.default
    split: float | None = SPLIT.default
    speed: str | None = SPEED.default
    weight: tuple[str, ...] | Weighting = WEIGHT.default
    rate: float | None = RATE.default
    delay: float = DELAY.default
    ignore_findings: bool = IGNORE_FINDINGS.default
    sizes: Mapping[str, Size] = field(default_factory=dict)

    @classmethod
    def of(cls, given: Mapping[str, Any], base: IdentifyRequest | None = None) -> IdentifyRequest:
        """Return the request for values by the names of options; what is not given, or None, is as in `base`.

        Raises CesError that names the option at fault: its value is wrong, or it does not apply to the structure.
        """
        base = base or cls()
        options = {option.name: option for option in list_options() if option.name != TEACHER.name}
        values = {name: _read(options, name, value) for name, value in given.items() if value is not None}
        structure = values.get(STRUCTURE, base.structure)
        for name in values:
            if (only := _structure_of(name)) and structure not in (only, AUTO):
                chosen = OptionName(STRUCTURE, only)
                others = f" or {AUTO}, not to {structure}; remove it"
                raise CesError(OptionName(name), " applies to ", chosen, others)
        own = {declared.name for declared in fields(cls)}
        sizes = {name: value for name, value in values.items() if name not in own}
        own_values = {name: value for name, value in values.items() if name in own}
        return replace(base, **own_values, sizes={**base.sizes, **sizes})

    def options(self, base: IdentifyOptions | None = None) -> IdentifyOptions:
        """Return the settings of an identification, with what no option says as in `base`; raises CesError."""
        base = base or IdentifyOptions()
        values = {declared.name: getattr(self, declared.name) for declared in fields(self)}
        rules = self.candidates
        if not isinstance(rules, CandidateRules):
            rules = load_rules(rules, self.method)
        weight = self.weight if isinstance(self.weight, Weighting) else parse_weighting(self.weight)
        values |= {"candidates": reduce(add_blend, self.blend, rules), "weight": weight}
        values |= {"time": inf if self.time is None else self.time, "threads": self.threads or os.cpu_count() or 1}
        limits = replace(base.limits, **{f.name: values[f.name] for f in fields(Limits) if f.name in values})
        own = {f.name: values[f.name] for f in fields(IdentifyOptions) if f.name in values}
        return replace(base, **{**own, "limits": limits})

    @property
    def all_sizes(self) -> dict[str, Size]:
        """The sizes of all structures, those that are not given with their defaults."""
        return {**default_sizes(), **self.sizes}

    def fitter(self) -> Fitter:
        """Return the fitter of the structure; raises CesError for a size that it cannot have."""
        try:
            return (BestStructure if self.structure == AUTO else KITS[self.structure].fitter)(self.all_sizes)
        except ValueError as error:
            raise CesError(OptionName(STRUCTURE, self.structure), f": {error}") from None


def _read(options: Mapping[str, Option], name: str, value: Any) -> Any:
    """Return the checked value of an option, a list as a tuple; raises CesError that names the option."""
    if name not in options:
        raise CesError(OptionName(name), f" is unknown{suggest(name, options)}")
    if isinstance(value, Weighting | CandidateRules):
        return value
    if options[name].many and isinstance(value, str):
        value = [value]
    try:
        read = options[name].read(value)
    except FieldError as error:
        raise CesError(OptionName(name), f"{error.place}{error.words}") from None
    return Path(read) if options[name].kind is Path else read


def _structure_of(name: str) -> str:
    """Return the structure to which alone an option applies, empty if it applies to all."""
    if name in (METHOD.name, TERMS.name, CANDIDATES.name, BLEND.name):
        return POLYNOMIAL.option
    return next((kit.option for kit in KITS.values() if name in {size.name for size in kit.sizes}), "")
