"""The flat file: a model as the arrays of `ces_observer.tick`, which C++ and C programs load at run time.

Little endian: MAGIC; the version and the length of the text, each 32 bits; the text, lines `key=value` in UTF-8; zeros
up to a multiple of 8. Then, for the sampling and the structure (`EstimatorArrays`): the sizes of p, n, s and k, p as
doubles, and n, all of 64 bits. Last the CRC-32 of all before it, 32 bits.
"""

from __future__ import annotations

import struct
import zlib

from ces_observer import __version__
from ces_observer.core import tick_digest
from ces_observer.errors import ModelError
from ces_observer.estimator import EstimatorArrays, lay_out_estimator
from ces_observer.flat import Arrays
from ces_observer.model import Model
from ces_observer.proof.certificate import Certificate
from ces_observer.tick.estimator import check_model

MAGIC = b"CES-FLAT"
VERSION = 2
HEAD = struct.Struct("<8sII")
SIZES = struct.Struct("<4q")
CHECKSUM = struct.Struct("<I")


def write_flat(model: Model, name: str, certificate: Certificate) -> bytes:
    """Return the bytes of the flat file. Raises ModelError if the tick would not stay within the model's arrays."""
    arrays = lay_out_estimator(model)
    require_within(arrays, name)
    text = "".join(f"{key}={_as_line(value)}\n" for key, value in _facts(model, name, certificate).items()).encode()
    content = HEAD.pack(MAGIC, VERSION, len(text)) + text
    content += bytes(-len(content) % 8) + b"".join(map(_pack, arrays))
    return content + CHECKSUM.pack(zlib.crc32(content))


def require_within(arrays: EstimatorArrays, source: str) -> None:
    """Raise ModelError unless the tick stays within all arrays, whatever its samples are."""
    sizes = [[part.p, part.n, *map(len, part)] for part in arrays]
    if not check_model(*(value for part in sizes for value in part)):  # type: ignore[arg-type]
        raise ModelError(f"{source}: its arrays are not those of a model; identify the model again")


def _facts(model: Model, name: str, certificate: Certificate) -> dict[str, object]:
    """Return what a program shows of the model, and needs beside the arrays."""
    sampling = model.sampling
    return {
        "core": tick_digest(),
        "model": model.digest(),
        "name": name,
        "size": model.size,
        "outside": model.body.outside,
        "extrapolates": int(model.body.extrapolates),
        "motion": sampling.motion,
        "rate_Hz": sampling.rate_Hz,
        "stroke_min_m": sampling.stroke_m[0],
        "stroke_max_m": sampling.stroke_m[1],
        "delay_s": sampling.delay_s,
        "max_gap_s": sampling.max_gap_s,
        "max_current_age_s": sampling.max_current_age_s,
        "proved": int(certificate.holds),
        "force_bound_N": certificate.force_N,
        "claim": certificate.claim,
        "version": __version__,
    }


def _as_line(value: object) -> str:
    return " ".join(str(value).split())


def _pack(part: Arrays) -> bytes:
    """Return the bytes of the arrays of a part; the state is new whenever it is loaded."""
    sizes = SIZES.pack(*map(len, part))
    return sizes + struct.pack(f"<{len(part.p)}d", *part.p) + struct.pack(f"<{len(part.n)}q", *part.n)
