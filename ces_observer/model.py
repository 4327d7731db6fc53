"""The model file: `model.json` in, a checked `Model` out, and back.

The file is plain JSON, holds numbers and names only, is limited in size and never executed. Everything is checked
here, once, so that the estimator need not: keys, types, ranges, what a term can reach and what a tick costs in memory.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from math import prod
from pathlib import Path
from typing import Any

from ces_observer.checked import Checked, write_beside
from ces_observer.errors import ModelError
from ces_observer.json_text import parse_json, read_bounded
from ces_observer.structures.constructed import Constructed, Hat
from ces_observer.structures.constructed_file import MOST_CONSTRUCTED, constructed_from
from ces_observer.structures.fuzzy import Fuzzy, fuzzy_from
from ces_observer.structures.network import Network, network_from

SCHEMA = "ces-model/1"
STRUCTURES = ("polynomial_narx", "sigmoid_narx", "anfis")
SIGNALS = ("force", "speed", "current", "position")
UNITS = {"force": "N", "speed": "m/s", "current": "A", "position": "m", "lag": "1/rate_Hz"}
KEYS = ("schema", "structure", "units", "sampling", "input_envelope", "force_envelope_N", "certificate", "provenance")
BODIES = {"polynomial_narx": ("terms", "constructed"), "sigmoid_narx": ("network",), "anfis": ("fuzzy",)}
MAX_BYTES = 1_000_000
MAX_TERMS = 500
MAX_FACTORS = 8
MAX_LAG = 1000
MAX_POWER = 8.0
MOST_INPUT = 1e6  # [m, m/s, A] and [N]: beyond any damper, and far from where powers overflow
MOST_FORCE_N = 1e9
MOST_COEFFICIENT = 1e30
MOST_REACH = 1e100  # of a term and of its factors' product: sums, slopes and bounds of them stay far from overflow
MOST_GAP_TICKS = 20_000  # what one position sample after the longest bridged gap may cost

Range = tuple[float, float]


@dataclass(frozen=True)
class Factor:
    """One factor of a term: a signal `lag` ticks ago, as |s|^power, or as sign(s) |s|^power if `signed`.

    A `force` factor is the model's own past output (lag >= 1, power 1, signed). A signal that is none of SIGNALS is
    constructed from them; its `definition` tells how.
    """

    signal: str
    lag: int
    power: float = 1.0
    signed: bool = True
    definition: Constructed | None = None

    @property
    def variable(self) -> tuple[str, int]:
        """What the factor is a function of, signal and lag: a hat is one of the signal it is of."""
        return (self.definition.of if isinstance(self.definition, Hat) else self.signal), self.lag


@dataclass(frozen=True)
class Term:
    """A coefficient [N per product of the factors' units] times its factors, at most one of them a past force."""

    coefficient: float
    factors: tuple[Factor, ...]

    @property
    def output_lag(self) -> int:
        """Lag of the past force in ticks, 0 if there is none."""
        return next((f.lag for f in self.factors if f.signal == "force"), 0)

    @property
    def inputs(self) -> tuple[Factor, ...]:
        """The factors that are not past forces."""
        return tuple(f for f in self.factors if f.signal != "force")


@dataclass(frozen=True)
class Sampling:
    """How irregular samples become the model's uniform ticks; the same numbers rule offline and on the vehicle."""

    rate_Hz: float
    bandwidth_Hz: float  # [Hz] of the differentiator
    outlier_m: float  # [m] a position further than this from its prediction is dropped
    max_gap_s: float = 0.05  # [s] a longer silence restarts the estimator
    max_current_age_s: float = 0.2  # [s] an older current is no current
    warm_up_s: float = 0.5  # [s] withheld, and left out of costs, after each restart
    order: int = 3  # of the differentiator: 2 (white acceleration) or 3 (white jerk)


@dataclass(frozen=True)
class Envelope:
    """Range of each input the model was identified on; inputs are clamped to it."""

    position_m: Range
    speed_m_s: Range
    current_A: Range

    @property
    def by_signal(self) -> Mapping[str, Range]:
        """The ranges by the signals' names."""
        return {"position": self.position_m, "speed": self.speed_m_s, "current": self.current_A}


@dataclass(frozen=True)
class Model:
    """A force model ready to run: force [N] from position [m], speed [m/s] and current [A] at `sampling.rate_Hz`.

    `structure` tells which of `terms` (polynomial_narx), `network` (sigmoid_narx) and `fuzzy` (anfis) makes the force.
    """

    structure: str
    sampling: Sampling
    terms: tuple[Term, ...]
    envelope: Envelope
    force_envelope_N: Range
    certificate: Mapping[str, Any] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    network: Network | None = None
    fuzzy: Fuzzy | None = None

    @property
    def max_lag(self) -> int:
        """Longest lag of any factor or regressor in ticks."""
        body = self.network or self.fuzzy
        return body.max_lag if body else max((f.lag for t in self.terms for f in t.factors), default=0)

    @property
    def constructed(self) -> tuple[Constructed, ...]:
        """The constructed inputs its terms use, each after those it is made of."""
        return constructed_in(self.terms)

    @property
    def size(self) -> str:
        """How large the model is, for people."""
        body = self.network or self.fuzzy
        return body.size if body else f"{len(self.terms)} terms"

    def to_json(self) -> str:
        """Return the text of the model file."""
        body = {
            "schema": SCHEMA,
            "structure": self.structure,
            "units": UNITS,
            "sampling": asdict(self.sampling),
            **self._body(),
            "input_envelope": asdict(self.envelope),
            "force_envelope_N": self.force_envelope_N,
            "certificate": self.certificate,
            "provenance": self.provenance,
        }
        return json.dumps(body, indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def _body(self) -> dict[str, Any]:
        if self.network is not None:
            return {"network": self.network.to_json()}
        if self.fuzzy is not None:
            return {"fuzzy": self.fuzzy.to_json()}
        constructed = {"constructed": [one.to_json() for one in self.constructed]} if self.constructed else {}
        return {**constructed, "terms": [_term_to_json(term) for term in self.terms]}

    def save(self, path: Path) -> None:
        """Write the model file beside `path`, then rename it into place."""
        write_beside(path, self.to_json())

    def digest(self) -> str:
        """Return the SHA-256 of the model file's text, by which a running observer names its model."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()


def constructed_in(terms: Sequence[Term]) -> tuple[Constructed, ...]:
    """Return the constructed inputs of `terms` by name, hats last; raises ModelError if two of a name differ."""
    known: dict[str, Constructed] = {}
    used = {f.definition for term in terms for f in term.factors if f.definition is not None}
    for one in used | {one.base for one in used if isinstance(one, Hat) and one.base is not None}:
        if known.setdefault(one.name, one) != one:
            raise ModelError(f"constructed input '{one.name}': defined twice, differently; expected a name for each")
    return tuple(sorted(known.values(), key=lambda one: (isinstance(one, Hat), one.name)))


def load_model(path: Path) -> Model:
    """Read and check a model file; raises ModelError naming the file and the key that is wrong."""
    try:
        text = read_bounded(path, MAX_BYTES)
    except FileNotFoundError:
        raise ModelError(f"{path}: no such model file; `ces identify BAG --out {path.name}` writes one") from None
    except OSError as error:
        raise ModelError(f"{path}: cannot be read as a model file: {error.strerror}") from None
    return parse_model(text, str(path))


def parse_model(text: str, source: str) -> Model:
    """Check the text of a model file; `source` names it in errors. Raises ModelError."""
    if len(text) > MAX_BYTES:
        raise ModelError(f"{source}: {len(text)} characters; a model file has at most {MAX_BYTES} bytes")
    root = Checked(parse_json(text, source), source)
    schema = root.text("schema")
    if schema != SCHEMA:
        raise ModelError(f"{source}: schema is {schema[:40]!r}; this version reads '{SCHEMA}': identify the model anew")
    structure = root.choice("structure", STRUCTURES)
    if root.value.get("units", UNITS) != UNITS:
        raise ModelError(f"{source}: units are not those of '{SCHEMA}'; expected {UNITS}")
    model = _model(root, structure)
    root.only(*KEYS, *BODIES[structure])
    return model


def _model(root: Checked, structure: str) -> Model:
    envelope = _envelope(root.at("input_envelope"))
    return Model(
        structure=structure,
        sampling=_sampling(root.at("sampling")),
        terms=_terms(root, envelope) if structure == "polynomial_narx" else (),
        envelope=envelope,
        force_envelope_N=root.range("force_envelope_N", MOST_FORCE_N),
        certificate=root.mapping_or_none("certificate"),
        provenance=root.mapping_or_none("provenance") or {},
        network=network_from(root.at("network")) if structure == "sigmoid_narx" else None,
        fuzzy=fuzzy_from(root.at("fuzzy"), envelope.by_signal) if structure == "anfis" else None,
    )


def _sampling(node: Checked) -> Sampling:
    node.only(*(one.name for one in fields(Sampling)))
    sampling = Sampling(
        rate_Hz=node.number("rate_Hz", 1.0, 100e3),
        bandwidth_Hz=node.number("bandwidth_Hz", 1e-3, 50e3),
        outlier_m=node.number("outlier_m", 1e-9, 1e3),
        max_gap_s=node.number("max_gap_s", 1e-4, 10.0),
        max_current_age_s=node.number("max_current_age_s", 1e-4, 1e6),
        warm_up_s=node.number("warm_up_s", 0.0, 60.0),
        order=node.whole("order", 2, 3),
    )
    ticks = sampling.rate_Hz * sampling.max_gap_s
    if ticks > MOST_GAP_TICKS:
        raise ModelError(f"{node.where}: max_gap_s spans {ticks:.0f} ticks; expected at most {MOST_GAP_TICKS}")
    return sampling


def _envelope(node: Checked) -> Envelope:
    keys = tuple(one.name for one in fields(Envelope))
    node.only(*keys)
    return Envelope(*(node.range(key, MOST_INPUT) for key in keys))


def _terms(root: Checked, envelope: Envelope) -> tuple[Term, ...]:
    given = root.items("constructed", 1, MOST_CONSTRUCTED) if "constructed" in root.value else ()
    constructed = constructed_from(given)
    return tuple(_term(item, constructed, envelope) for item in root.items("terms", 1, MAX_TERMS))


def _term(node: Checked, constructed: Mapping[str, Constructed], envelope: Envelope) -> Term:
    node.only("coefficient", "factors")
    factors = tuple(_factor(item, constructed) for item in node.items("factors", 0, MAX_FACTORS))
    if sum(f.signal == "force" for f in factors) > 1:
        raise ModelError(f"{node.where}: more than one past force; expected at most one, so that bounds can be proved")
    term = Term(node.number("coefficient", -MOST_COEFFICIENT, MOST_COEFFICIENT), factors)
    if not _reach(term, envelope) <= MOST_REACH:
        raise ModelError(f"{node.where}: can grow beyond {MOST_REACH:g} in the input envelope; expected lower powers")
    return term


def _reach(term: Term, envelope: Envelope) -> float:
    """Return what bounds the term's product over the envelope, and every part of that product."""
    ranges = envelope.by_signal
    ends = [ranges[f.signal] if f.definition is None else f.definition.range(ranges) for f in term.inputs]
    sizes = [max(1.0, *map(abs, end)) ** f.power for f, end in zip(term.inputs, ends, strict=True)]
    return prod([max(1.0, abs(term.coefficient)), *sizes])


def _factor(node: Checked, constructed: Mapping[str, Constructed]) -> Factor:
    signal = node.choice("signal", (*SIGNALS, *constructed))
    if signal == "force":
        node.only("signal", "lag")
        return Factor("force", node.whole("lag", 1, MAX_LAG))
    node.only("signal", "lag", "power", "signed")
    lag = node.whole("lag", 0, MAX_LAG)
    power, definition = node.number("power", 0.0, MAX_POWER), constructed.get(signal)
    if isinstance(definition, Hat) and power != 1.0:
        raise ModelError(f"{node.where}: power is {power:g}; expected 1, as '{signal}' is a membership")
    return Factor(signal, lag, power, node.flag("signed"), definition)


def _term_to_json(term: Term) -> dict[str, Any]:
    factors = [
        {"signal": f.signal, "lag": f.lag}
        if f.signal == "force"
        else {"signal": f.signal, "lag": f.lag, "power": f.power, "signed": f.signed}
        for f in term.factors
    ]
    return {"coefficient": term.coefficient, "factors": factors}
