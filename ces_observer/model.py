"""The model file: `model.json` in, a checked `Model` out, and back.

The file is plain JSON of numbers and names, limited in size and never executed. Keys, types, ranges and the cost of a
tick are checked once, here or by the structure, so that the estimator need not check them.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

from ces_observer.band import Band
from ces_observer.bank_design import ACCELERATION, SPEED, BankSettings
from ces_observer.errors import ModelError, Suggesting
from ces_observer.fields import REQUIRED, Field
from ces_observer.flat import ArrayLayout
from ces_observer.json_text import parse_json, read_bounded, write_atomically
from ces_observer.limits import FileLimits, NumberLimits
from ces_observer.proof.certificate import Certificate
from ces_observer.records import OneOf, Record, bounded, choice, part, quantity, read_document, write_record
from ces_observer.structures import STRUCTURES
from ces_observer.structures.structure import OperatingRange, Predictor, Range, Ranges, Structure
from ces_observer.tick.model import WARM_UP

SCHEMA = "ces-model/1"
GONE = ("relaxation", "chambers")  # structures of earlier versions
UNITS = {"force": "N", "speed": "m/s", "current": "A", "position": "m", "lag": "1/rate_Hz"}
MOTIONS = (SPEED, ACCELERATION)  # signals that may be measured beside the position
FREQUENCIES_HZ = (3.0, 6.0, 12.0, 24.0, 48.0)  # of the bank's modes: strokes of vehicles and rigs


@dataclass(frozen=True)
class Sampling:
    """How irregular samples become the model's uniform ticks, both offline and on the vehicle."""

    rate_Hz: float = quantity(REQUIRED, "Hz", "ticks a second", 1.0, 100e3)
    noise_m: float = quantity(REQUIRED, "m", "RMS noise of the positions", 1e-12, 1.0)
    speed_m_s: float = quantity(REQUIRED, "m/s", "RMS speed of the identification recordings", 1e-9, 1e3)
    stroke_m: Range = quantity(
        REQUIRED, "m", "positions outside are not believed", -NumberLimits.MAX_INPUT, NumberLimits.MAX_INPUT
    )
    outlier_m: float = quantity(REQUIRED, "m", "a position further from its prediction is dropped", 1e-9, 1e3)
    frequencies_Hz: tuple[float, ...] = bounded(
        0.0,
        FileLimits.MAX_MODE_HZ,
        "of the modes of the bank",
        FREQUENCIES_HZ,
        unit="Hz",
        max_count=FileLimits.MAX_MODES,
    )
    max_gap_s: float = quantity(0.05, "s", "a longer silence restarts the estimator", 1e-4, 10.0)
    max_current_age_s: float = quantity(0.2, "s", "an older current is not used", 1e-4, 1e6)
    warm_up_s: float = quantity(0.5, "s", "after each restart: forces are withheld, and not scored", 0.0, 60.0)
    delay_s: float = quantity(
        0.0, "s", "after a sample, at which its speed is taken and its force comes out", 0.0, FileLimits.MAX_DELAY_S
    )
    motion: str = choice("", "the signal measured beside the position, if any", MOTIONS, optional=True)
    motion_noise: float = bounded(
        1e-9, 1e6, "its RMS noise, in its unit", 0.0, when=lambda values: values.get("motion")
    )

    def checked(self) -> Self:
        """Return it; raises ModelError unless its numbers fit together."""
        if not all(0.0 < f < 0.5 * self.rate_Hz for f in self.frequencies_Hz):
            raise ModelError(f"frequencies_Hz are {self.frequencies_Hz}; expected 0 to half the rate")
        if (ticks := self.rate_Hz * self.max_gap_s) > FileLimits.MAX_GAP_TICKS:
            raise ModelError(f"max_gap_s spans {ticks:.0f} ticks; expected at most {FileLimits.MAX_GAP_TICKS}")
        if abs(self.delay_ticks - self.delay_s * self.rate_Hz) > 1e-6:
            raise ModelError(f"delay_s is {self.delay_s:g}; expected whole ticks of {1.0 / self.rate_Hz:g} s")
        return self

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


@dataclass(frozen=True, repr=False)
class Envelope(Suggesting):
    """Range of each input in the identification data, widened a little; structures clamp to it, or extrapolate.

    Between the ends of `current_gap_A` no current was recorded: forces there are interpolated, and nothing tests them.
    """

    position_m: Range = bounded(-NumberLimits.MAX_INPUT, NumberLimits.MAX_INPUT)
    speed_m_s: Range = bounded(-NumberLimits.MAX_INPUT, NumberLimits.MAX_INPUT)
    current_A: Range = bounded(-NumberLimits.MAX_INPUT, NumberLimits.MAX_INPUT)
    current_gap_A: Range | None = bounded(-NumberLimits.MAX_INPUT, NumberLimits.MAX_INPUT, default=None, optional=True)

    def __repr__(self) -> str:
        shown = (f"{name}=({ends[0]:.4g}, {ends[1]:.4g})" for name, ends in asdict(self).items() if ends is not None)
        return f"Envelope({', '.join(shown)})"

    @property
    def by_signal(self) -> Ranges:
        """The ranges by the signals' names."""
        return {"position": self.position_m, "speed": self.speed_m_s, "current": self.current_A}

    @property
    def gap_text(self) -> str:
        """What follows the range of the current in a text: between which currents [A] none was recorded, if so."""
        return "" if self.current_gap_A is None else " without {:.3g} to {:.3g}".format(*self.current_gap_A)


@dataclass(frozen=True)
class Model:
    """A force model: force [N] from position [m], speed [m/s] and current [A] at `sampling.rate_Hz`.

    `body` is the structure that computes the force; the rest is the same for every structure. `band` says how far the
    measured force may lie from it, None if that is not known. `settles_s` [s] is how long the force of a run on its
    recordings depends on where it began.
    """

    sampling: Sampling
    body: Structure = part(kind=OneOf(STRUCTURES, "structure"), inline=True)
    envelope: Envelope = part(key="input_envelope")
    force_envelope_N: Range = bounded(-NumberLimits.MAX_NUMBER, NumberLimits.MAX_NUMBER)
    certificate: Mapping[str, Any] | None = None
    settles_s: float = bounded(0.0, 60.0, default=0.0, optional=True)
    band: Band | None = part(default=None, optional=True)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def checked(self) -> Self:
        """Return it; raises ModelError if the structure does not fit the envelope."""
        self.body.check_over(self.envelope.by_signal)
        return self

    @property
    def used_ranges(self) -> Ranges:
        """The envelope of the inputs that the structure uses, by name: others cannot be outside."""
        return {name: self.envelope.by_signal[name] for name in self.body.uses}

    @property
    def used_gap_A(self) -> Range | None:
        """The gap of the recorded currents, of a structure that uses the current."""
        return self.envelope.current_gap_A if "current" in self.body.uses else None

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
        rate_Hz, ranges = self.sampling.rate_Hz, self.envelope.by_signal
        return OperatingRange(rate_Hz, ranges, self.force_envelope_N, self.used_gap_A)

    def make_predictor(self) -> Predictor:
        """Return a new free run."""
        return self.body.make_predictor(self.operating_range)

    def lay_out(self) -> ArrayLayout:
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
        content = {"schema": SCHEMA, "units": UNITS, **write_record(self)}
        return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def save(self, path: str | Path) -> None:
        """Write the model file, as a whole or not at all; raises CesError."""
        write_atomically(Path(path), self.to_json())

    def digest(self) -> str:
        """Return the SHA-256 of the model file's text, which diagnostics show."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()


FILE = Field(kind=Record(Model))


def load_model(path: str | Path) -> Model:
    """Read and check a model file; raises ModelError naming the file and the wrong key."""
    if not isinstance(path, str | os.PathLike):
        raise ModelError(
            f"model: expected a model or the path of its file; got {path if path is None else type(path).__name__}"
        )
    path = Path(path)
    if path.is_dir() or (path.is_file() and path.suffix.lower() not in ("", ".json")):
        what = "folder, such as a bag" if path.is_dir() else f"{path.suffix} file, such as a recording"
        raise ModelError(f"{path}: is a {what}, and no model; `ces identify {path} --out model.json` makes one of it")
    try:
        text = read_bounded(path, FileLimits.MAX_BYTES)
    except FileNotFoundError:
        raise ModelError(f"{path}: no such model file; `ces identify BAG --out {path.name}` writes one") from None
    except OSError as error:
        raise ModelError(f"{path}: cannot be read as a model file: {error.strerror}") from None
    return parse_model(text, str(path))


def parse_model(text: str, source: str) -> Model:
    """Check the text of a model file; `source` names it in errors. Raises ModelError."""
    if len(text) > FileLimits.MAX_BYTES:
        raise ModelError(f"{source}: {len(text)} characters; a model file has at most {FileLimits.MAX_BYTES} bytes")
    values = parse_json(text, source)
    if isinstance(values, dict):
        _refuse_other_versions(values, source)
        values.pop("units", None)
    model: Model = read_document(FILE, values, source, SCHEMA, "identify the model again", ModelError)
    return model


def _refuse_other_versions(values: Mapping[str, Any], source: str) -> None:
    again, sampling = "identify the model again", values.get("sampling")
    if values.get("units", UNITS) != UNITS:
        raise ModelError(f"{source}: units are not those of '{SCHEMA}'; expected {UNITS}")
    if "delayed" in values:
        text = "holds a second model in the key 'delayed'; expected one model a file"
        raise ModelError(f"{source}: {text}: identify again, once for each --delay")
    if (name := values.get("structure")) in GONE:
        raise ModelError(f"{source}: structure is {name!r}; 'hydraulic' took its place: {again}")
    if isinstance(sampling, Mapping) and "bandwidth_Hz" in sampling:
        raise ModelError(f"{source}: sampling: written by a version that estimated the speed otherwise: {again}")
