"""The model file: `model.json` in, a checked `Model` out, and back.

The file is plain JSON of numbers and names, limited in size and never executed. Keys, types, ranges and the cost of a
tick are checked once, here or by the structure, so that the estimator need not check them.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from ces_observer.band import Band
from ces_observer.errors import ModelError
from ces_observer.json_text import JsonObject, parse_json, read_bounded, write_atomically
from ces_observer.proof.certificate import Certificate
from ces_observer.structures import STRUCTURES
from ces_observer.structures.structure import OperatingRange, Predictor, Range, Ranges, Structure

SCHEMA = "ces-model/1"
BAND = "band"  # optional key
UNITS = {"force": "N", "speed": "m/s", "current": "A", "position": "m", "lag": "1/rate_Hz"}
KEYS = ("schema", "structure", "units", "sampling", "input_envelope", "force_envelope_N", "certificate", "provenance")
MAX_BYTES = 1_000_000
KALMAN, ADAPTIVE, FUSED, MEASURED = "kalman", "adaptive", "fused", "measured"
DIFFERENTIATORS = {KALMAN: "", ADAPTIVE: "", FUSED: "acceleration", MEASURED: "speed"}  # and the signal each needs
MAX_INPUT = 1e6  # [m, m/s, A]: beyond any damper, and far from where powers overflow
MAX_FORCE_N = 1e9
MAX_GAP_TICKS = 20_000  # that one position sample may have to compute, after the longest bridged gap


@dataclass(frozen=True)
class Sampling:
    """How irregular samples become the model's uniform ticks, both offline and on the vehicle."""

    rate_Hz: float
    bandwidth_Hz: float  # [Hz] of the differentiator
    outlier_m: float  # [m] a position further than this from its prediction is dropped
    max_gap_s: float = 0.05  # [s] a longer silence restarts the estimator
    max_current_age_s: float = 0.2  # [s] an older current is not used
    warm_up_s: float = 0.5  # [s] after each restart: forces are withheld, and not scored
    order: int = 3  # of the differentiator: 2 (white acceleration) or 3 (white jerk)
    differentiator: str = KALMAN  # where the speed comes from, one of DIFFERENTIATORS
    noise_m: float = 0.0  # [m] RMS noise of the positions, for the adaptive differentiator

    @property
    def motion_signal(self) -> str:
        """The signal that is measured beside the position for the speed; empty: none."""
        return DIFFERENTIATORS[self.differentiator]

    def to_json(self) -> dict[str, Any]:
        """Return the object in the model file; a plain Kalman filter needs no further keys."""
        content = asdict(self)
        if self.differentiator != ADAPTIVE:
            del content["noise_m"]
        if self.differentiator == KALMAN:
            del content["differentiator"]
        return content


@dataclass(frozen=True)
class Envelope:
    """Range of each input in the identification data, widened a little; structures clamp to it, or extrapolate."""

    position_m: Range
    speed_m_s: Range
    current_A: Range

    @property
    def by_signal(self) -> Ranges:
        """The ranges by the signals' names."""
        return {"position": self.position_m, "speed": self.speed_m_s, "current": self.current_A}


@dataclass(frozen=True)
class Model:
    """A force model: force [N] from position [m], speed [m/s] and current [A] at `sampling.rate_Hz`.

    `body` is the structure that computes the force; the rest is the same for every structure. `band` says how far the
    measured force may lie from it, None if that is not known.
    """

    sampling: Sampling
    body: Structure
    envelope: Envelope
    force_envelope_N: Range
    certificate: Mapping[str, Any] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    band: Band | None = None

    @property
    def structure(self) -> str:
        """Name of the structure in the model file."""
        return self.body.name

    @property
    def size(self) -> str:
        """The model's size, in words."""
        return self.body.size

    @property
    def max_lag(self) -> int:
        """Longest lag of any signal in ticks."""
        return self.body.max_lag

    @property
    def operating_range(self) -> OperatingRange:
        """The rate and ranges for which its structure is run and proved."""
        return OperatingRange(self.sampling.rate_Hz, self.envelope.by_signal, self.force_envelope_N)

    def make_predictor(self) -> Predictor:
        """Return a new free run."""
        return self.body.make_predictor(self.operating_range)

    def certify(self) -> Certificate:
        """Return the certificate of its stability."""
        return self.body.certify(self.operating_range)

    def is_stable(self) -> bool:
        """Return whether it can be proved stable, whatever its file claims; faster than `certify`."""
        return self.body.is_stable(self.operating_range)

    def to_json(self) -> str:
        """Return the text of the model file."""
        content = {
            "schema": SCHEMA,
            "structure": self.structure,
            "units": UNITS,
            "sampling": self.sampling.to_json(),
            **self.body.to_json(),
            "input_envelope": asdict(self.envelope),
            "force_envelope_N": self.force_envelope_N,
            "certificate": self.certificate,
            **({} if self.band is None else {BAND: self.band.to_json()}),
            "provenance": self.provenance,
        }
        return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def save(self, path: str | Path) -> None:
        """Write the model file, as a whole or not at all; raises CesError."""
        write_atomically(Path(path), self.to_json())

    def digest(self) -> str:
        """Return the SHA-256 of the model file's text, which diagnostics show."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()


def load_model(path: str | Path) -> Model:
    """Read and check a model file; raises ModelError naming the file and the wrong key."""
    if not isinstance(path, str | os.PathLike):
        raise ModelError(f"expected the path of a model file; got a value of type {type(path).__name__}")
    path = Path(path)
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
    root = JsonObject(parse_json(text, source), source)
    schema = root.text("schema")
    if schema != SCHEMA:
        raise ModelError(
            f"{source}: schema is {schema[:40]!r}; this version reads '{SCHEMA}': identify the model again"
        )
    structure = STRUCTURES[root.choice("structure", tuple(STRUCTURES))]
    if root.value.get("units", UNITS) != UNITS:
        raise ModelError(f"{source}: units are not those of '{SCHEMA}'; expected {UNITS}")
    inputs, names = root.at("input_envelope"), [one.name for one in fields(Envelope)]
    inputs.require_only_keys(*names)
    envelope = Envelope(*(inputs.range(name, MAX_INPUT) for name in names))
    model = Model(
        sampling=_sampling(root.at("sampling")),
        body=structure.from_json(root, envelope.by_signal),
        envelope=envelope,
        force_envelope_N=root.range("force_envelope_N", MAX_FORCE_N),
        certificate=root.mapping_or_none("certificate"),
        provenance=root.mapping_or_none("provenance") or {},
        band=Band.from_json(root.at(BAND)) if BAND in root.value else None,
    )
    root.require_only_keys(*KEYS, BAND, *structure.keys)
    return model


def _sampling(node: JsonObject) -> Sampling:
    kind = node.choice("differentiator", tuple(DIFFERENTIATORS)) if "differentiator" in node.value else KALMAN
    node.require_only_keys(*(one.name for one in fields(Sampling) if one.name != "noise_m" or kind == ADAPTIVE))
    sampling = Sampling(
        rate_Hz=node.number("rate_Hz", 1.0, 100e3),
        bandwidth_Hz=node.number("bandwidth_Hz", 1e-3, 50e3),
        outlier_m=node.number("outlier_m", 1e-9, 1e3),
        max_gap_s=node.number("max_gap_s", 1e-4, 10.0),
        max_current_age_s=node.number("max_current_age_s", 1e-4, 1e6),
        warm_up_s=node.number("warm_up_s", 0.0, 60.0),
        order=node.integer("order", 2, 3),
        differentiator=kind,
        noise_m=node.number("noise_m", 1e-12, 1.0) if kind == ADAPTIVE else 0.0,
    )
    if kind == FUSED and sampling.order != 3:
        raise ModelError(f"{node.where}: order is {sampling.order}; expected 3 with differentiator {FUSED}")
    ticks = sampling.rate_Hz * sampling.max_gap_s
    if ticks > MAX_GAP_TICKS:
        raise ModelError(f"{node.where}: max_gap_s spans {ticks:.0f} ticks; expected at most {MAX_GAP_TICKS}")
    return sampling
