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
from ces_observer.bank_design import ACCELERATION, SPEED, BankSettings
from ces_observer.errors import ModelError
from ces_observer.flat import Layout
from ces_observer.json_text import JsonObject, parse_json, read_bounded, write_atomically
from ces_observer.proof.certificate import Certificate
from ces_observer.structures import STRUCTURES
from ces_observer.structures.structure import MAX_FORCE_N, OperatingRange, Predictor, Range, Ranges, Structure
from ces_observer.tick.model import WARM_UP

SCHEMA = "ces-model/1"
GONE = ("relaxation", "chambers")  # structures of earlier versions
BAND = "band"  # optional key
UNITS = {"force": "N", "speed": "m/s", "current": "A", "position": "m", "lag": "1/rate_Hz"}
SETTLES = "settles_s"  # optional key
KEYS = ("schema", "units", "sampling", "structure", "input_envelope", "force_envelope_N", "certificate", "provenance")
MAX_BYTES = 1_000_000
MOTIONS = (SPEED, ACCELERATION)  # signals that may be measured beside the position
MAX_DELAY_S = 0.02
MAX_INPUT = 1e6  # [m, m/s, A]: beyond any damper, and far from where powers overflow
FREQUENCIES_HZ = (3.0, 6.0, 12.0, 24.0, 48.0)  # of the bank's modes: strokes of vehicles and rigs
MAX_MODES, MAX_FREQUENCY_HZ = 12, 5e3
MAX_GAP_TICKS = 20_000  # that one position sample may have to compute, after the longest bridged gap


@dataclass(frozen=True)
class Sampling:
    """How irregular samples become the model's uniform ticks, both offline and on the vehicle."""

    rate_Hz: float
    noise_m: float  # [m] RMS noise of the positions
    speed_m_s: float  # [m/s] RMS speed of the identification recordings
    stroke_m: Range  # [m] positions outside are not believed
    outlier_m: float  # [m] a position further than this from its prediction is dropped
    frequencies_Hz: tuple[float, ...] = FREQUENCIES_HZ  # of the modes of the bank
    max_gap_s: float = 0.05  # [s] a longer silence restarts the estimator
    max_current_age_s: float = 0.2  # [s] an older current is not used
    warm_up_s: float = 0.5  # [s] after each restart: forces are withheld, and not scored
    delay_s: float = 0.0  # [s] after a sample, at which its speed is taken and its force comes out
    motion: str = ""  # the signal measured beside the position, one of MOTIONS, if any
    motion_noise: float = 0.0  # [m/s or m/s2] its RMS noise

    @property
    def delay_ticks(self) -> int:
        """The delay in ticks."""
        return round(self.delay_s * self.rate_Hz)

    @property
    def stroke(self) -> BankSettings:
        """What the bank of the speed needs to know."""
        return BankSettings(
            self.rate_Hz,
            self.noise_m,
            self.speed_m_s,
            self.frequencies_Hz,
            self.max_gap_s,
            self.motion,
            self.motion_noise,
        )

    def to_json(self) -> dict[str, Any]:
        """Return the object in the model file; without a measured motion it has no keys for it."""
        content = asdict(self)
        return content if self.motion else {k: v for k, v in content.items() if not k.startswith("motion")}


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
    measured force may lie from it, None if that is not known. `settles_s` [s] is how long the force of a run on its
    recordings depends on where it began.
    """

    sampling: Sampling
    body: Structure
    envelope: Envelope
    force_envelope_N: Range
    certificate: Mapping[str, Any] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    band: Band | None = None
    settles_s: float = 0.0

    @property
    def warm_up_s(self) -> float:
        """How long [s] the estimator withholds forces after a restart."""
        return max(self.sampling.warm_up_s, self.settles_s)

    @property
    def structure(self) -> str:
        """Name of the structure in the model file."""
        return self.body.name

    @property
    def size(self) -> str:
        """The model's size, in words."""
        return self.body.size

    @property
    def operating_range(self) -> OperatingRange:
        """The rate and ranges for which its structure is run and proved."""
        return OperatingRange(self.sampling.rate_Hz, self.envelope.by_signal, self.force_envelope_N)

    def make_predictor(self) -> Predictor:
        """Return a new free run."""
        return self.body.make_predictor(self.operating_range)

    def lay_out(self) -> Layout:
        """Return the layout of a run of it: structure, warm-up and band; raises ModelError."""
        layout = self.body.lay_out(self.operating_range)
        layout.n[WARM_UP] = round(self.warm_up_s * self.sampling.rate_Hz)
        if self.band is not None:
            self.band.fill(layout, self.sampling.rate_Hz)
        return layout

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
            "units": UNITS,
            "sampling": self.sampling.to_json(),
            "structure": self.structure,
            **self.body.to_json(),
            "input_envelope": asdict(self.envelope),
            "force_envelope_N": self.force_envelope_N,
            "certificate": self.certificate,
            **({SETTLES: self.settles_s} if self.settles_s else {}),
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
    if root.value.get("units", UNITS) != UNITS:
        raise ModelError(f"{source}: units are not those of '{SCHEMA}'; expected {UNITS}")
    if "delayed" in root.value:
        raise ModelError(
            f"{source}: holds a second model in the key 'delayed'; expected one model a file: identify again, once for "
            "each --delay"
        )
    if root.value.get("structure") in GONE:
        name = root.value["structure"]
        raise ModelError(f"{source}: structure is {name!r}; 'hydraulic' took its place: identify the model again")
    sampling = _sampling(root.at("sampling"))
    structure = STRUCTURES[root.choice("structure", tuple(STRUCTURES))]
    inputs, names = root.at("input_envelope"), [one.name for one in fields(Envelope)]
    inputs.require_only_keys(*names)
    envelope = Envelope(*(inputs.range(name, MAX_INPUT) for name in names))
    model = Model(
        sampling=sampling,
        body=structure.from_json(root, envelope.by_signal),
        envelope=envelope,
        force_envelope_N=root.range("force_envelope_N", MAX_FORCE_N),
        certificate=root.mapping_or_none("certificate"),
        provenance=root.mapping_or_none("provenance") or {},
        band=Band.from_json(root.at(BAND)) if BAND in root.value else None,
        settles_s=root.number(SETTLES, 0.0, 60.0) if SETTLES in root.value else 0.0,
    )
    root.require_only_keys(*KEYS, SETTLES, BAND, *structure.keys)
    return model


def _sampling(node: JsonObject) -> Sampling:
    if "bandwidth_Hz" in node.value:
        raise ModelError(
            f"{node.where}: written by a version that estimated the speed otherwise: identify the model again"
        )
    motion = node.choice("motion", MOTIONS) if "motion" in node.value else ""
    node.require_only_keys(*(one.name for one in fields(Sampling) if motion or not one.name.startswith("motion")))
    listed = node.value.get("frequencies_Hz")
    count = min(len(listed), MAX_MODES) if isinstance(listed, list) and listed else 1
    sampling = Sampling(
        rate_Hz=node.number("rate_Hz", 1.0, 100e3),
        noise_m=node.number("noise_m", 1e-12, 1.0),
        speed_m_s=node.number("speed_m_s", 1e-9, 1e3),
        stroke_m=node.range("stroke_m", MAX_INPUT),
        outlier_m=node.number("outlier_m", 1e-9, 1e3),
        frequencies_Hz=node.numbers("frequencies_Hz", count, MAX_FREQUENCY_HZ),
        max_gap_s=node.number("max_gap_s", 1e-4, 10.0),
        max_current_age_s=node.number("max_current_age_s", 1e-4, 1e6),
        warm_up_s=node.number("warm_up_s", 0.0, 60.0),
        delay_s=node.number("delay_s", 0.0, MAX_DELAY_S),
        motion=motion,
        motion_noise=node.number("motion_noise", 1e-9, 1e6) if motion else 0.0,
    )
    if not all(0.0 < f < 0.5 * sampling.rate_Hz for f in sampling.frequencies_Hz):
        raise ModelError(f"{node.where}: frequencies_Hz are {sampling.frequencies_Hz}; expected 0 to half the rate")
    ticks = sampling.rate_Hz * sampling.max_gap_s
    if ticks > MAX_GAP_TICKS:
        raise ModelError(f"{node.where}: max_gap_s spans {ticks:.0f} ticks; expected at most {MAX_GAP_TICKS}")
    if abs(sampling.delay_ticks - sampling.delay_s * sampling.rate_Hz) > 1e-6:
        tick_s = 1.0 / sampling.rate_Hz
        raise ModelError(f"{node.where}: delay_s is {sampling.delay_s:g}; expected whole ticks of {tick_s:g} s")
    return sampling
