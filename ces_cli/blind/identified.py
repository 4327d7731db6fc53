"""The model that stands for the simulation where a blind test has none: identified from the reference recordings."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from ces_identify.identification import IdentificationResult, identify
from ces_identify.polynomial.search_limits import Limits
from ces_identify.recordings.recording import Recording
from ces_identify.structures import KITS
from ces_identify.structures.auto import PHYSICAL
from ces_identify.structures.kit import IdentifyOptions
from ces_observer.errors import CesError

MAX_SECONDS = 10.0  # for each structure
OPTIONS = IdentifyOptions(split=1.0, limits=Limits(seconds=MAX_SECONDS, starts=1, threads=1), band=False)


def identify_baseline(references: Sequence[Recording], path: Path) -> None:
    """Identify a model of the structures with physics inside and write the best to `path`; raises CesError.

    The best is that with the lowest cost on the part of the references that their search selects on.
    """
    models = list(_identify_each(references))
    if not models:
        raise CesError("no model could be identified from the reference recordings")
    min(models, key=lambda result: float(result.search_results[0].cost)).model.save(path)


def _identify_each(references: Sequence[Recording]) -> Iterator[IdentificationResult]:
    for option in PHYSICAL:
        kit = KITS[option]
        fitter = kit.fitter({size.name: size.default for size in kit.sizes})
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                yield identify(references, (), OPTIONS, lambda result: None, fitter)
        except CesError:
            continue
