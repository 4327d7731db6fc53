"""The model file: `model.json` in, a checked `Model` out, and back.

The file is plain JSON of numbers and names, limited in size and never executed. Keys, types, ranges and the cost of a
tick are checked once, here or by the structure, so that the estimator need not check them.

The band of a model says how far the measured force may lie from the estimate, tick by tick. Position, speed, current
and estimated force of each tick go in; the half-width [N] comes out. Estimate plus and minus half-width contain the
measured force, sensor noise included, at `level` of the ticks. `ces_observer.tick.band` has its equation. It grows with
the distance of the state from the recordings that the model was identified on (Mahalanobis, 1 in the root mean square
over them): an error that depends linearly on the state, by unknown amounts, grows like the distance.
`ces_identify.validation.band` finds the weights on held-out data.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from itertools import chain, islice
from math import exp
from pathlib import Path
from typing import Any, Self

from ces_observer.bank_design import ACCELERATION, SPEED, BankSettings
from ces_observer.errors import ModelError, Suggesting
from ces_observer.fields import REQUIRED, Field
from ces_observer.flat import ArrayLayout
from ces_observer.json_text import parse_json, read_bounded, write_atomically
from ces_observer.limits import FileLimits, NumberLimits
from ces_observer.proof.certificate import Certificate
from ces_observer.records import OneOf, Record, bounded, choice, declare, part, quantity, read_document, write_record
from ces_observer.shapes import ByName
from ces_observer.structures import STRUCTURES
from ces_observer.structures.structure import OperatingRange, Predictor, Range, Ranges, Structure
from ces_observer.tick import band as tick
from ces_observer.tick.model import HAS_BAND, WARM_UP

STATE = ("position", "speed", "current", "change of speed", "change of current")
PARTS = ("low_current_N", "high_current_N", "slow_N", "fast_N", "force", "change_of_force", "reversal_N")
ROWS = range(len(STATE), 0, -1)  # lengths of the rows of an upper triangle, from the diagonal on


def _as_rows(numbers: Iterable[float]) -> tuple[tuple[float, ...], ...]:
    triangle = iter(numbers)
    return tuple(tuple(islice(triangle, length)) for length in ROWS)


@dataclass(frozen=True, repr=False)
class Band:
    """The half-width as a function of the state.

    A change is a signal minus its low-pass with time constant `change_s`. A reversal counts exp(-age / `reversal_s`).
    "Slow" is 1 / (1 + u) and "fast" is u = |speed| / `speed_m_s`; "high current" is the position of the current in its
    recorded range `current_A`, from 0 to 1, and "low current" 1 minus that. `parts` are the weights in the order of
    PARTS. The distance is the length of `whitening` (upper triangular, rows) times the state's deviation from `mean`,
    at most `max_distance`; `constant_share` is the share of the squared error that does not grow with it.
    """

    level: float = bounded(0.01, 0.9999)
    change_s: float = bounded(1e-5, 1e3)
    reversal_s: float = bounded(1e-5, 1e3)
    speed_m_s: float = bounded(1e-9, NumberLimits.MAX_SQUARED)
    current_A: tuple[float, float] = bounded(-NumberLimits.MAX_SQUARED, NumberLimits.MAX_SQUARED)
    parts: tuple[float, ...] = declare(
        Field(
            kind=ByName(Field(kind=float, low=0.0, high=NumberLimits.MAX_SQUARED), PARTS, PARTS),
            make=lambda parts: tuple(parts.values()),
            text=lambda parts: dict(zip(PARTS, parts, strict=True)),
        )
    )
    mean: tuple[float, ...] = bounded(
        -NumberLimits.MAX_SQUARED, NumberLimits.MAX_SQUARED, min_count=len(STATE), max_count=len(STATE)
    )
    whitening: tuple[tuple[float, ...], ...] = bounded(
        -NumberLimits.MAX_SQUARED,
        NumberLimits.MAX_SQUARED,
        kind=float,
        many=True,
        min_count=sum(ROWS),
        max_count=sum(ROWS),
        make=_as_rows,
        text=lambda rows: list(chain.from_iterable(rows)),
    )
    max_distance: float = bounded(0.0, NumberLimits.MAX_INPUT)
    constant_share: float = bounded(0.0, 1.0)

    def __repr__(self) -> str:
        return f"Band: meant to hold {self.level:.0%} of the measured forces"

    def fill(self, layout: ArrayLayout, rate_Hz: float) -> None:
        """Write its numbers into the layout of a model, for `ces_observer.tick.band`."""
        low, high = self.current_A
        layout.n[HAS_BAND] = 1
        layout.p[tick.BAND_GAIN] = 1.0 - exp(-1.0 / (self.change_s * rate_Hz))
        layout.p[tick.BAND_FADE] = exp(-1.0 / (self.reversal_s * rate_Hz))
        layout.p[tick.BAND_LOW_A] = low
        layout.p[tick.BAND_PER_A] = 1.0 / (high - low) if high > low else 0.0
        layout.p[tick.BAND_SPEED] = self.speed_m_s
        layout.put(tick.LOW_CURRENT_WEIGHT, self.parts)
        layout.put(tick.BAND_MEAN, self.mean)
        layout.put(tick.BAND_WHITENING, chain.from_iterable(self.whitening))
        layout.p[tick.BAND_LIMIT] = self.max_distance * self.max_distance
        layout.p[tick.BAND_SHARE] = self.constant_share


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
