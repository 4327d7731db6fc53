"""Offline identification: recordings go in; selected, validated and proved models come out. Needs no ROS.

The rooms in reading order: `limits` (the numbers that decide), `prepare` (uniform ticks), `numerics` (kernels and
searches), `polynomial`, `training` and `physical` (what fits need), `structures` (a fit and a kit each), `simulations`
(anything that computes a force), `validation` (how good a model is), `comparison` (several models on the same
recordings), `export` (C, FMU, C++), `report` (the page), `characteristics` (what a damper dyno shows), `campaign` (many
identifications) on `jobs` (many jobs at once). The names below are the public interface; they are imported when they
are first used.
"""

from typing import TYPE_CHECKING

from ces_observer.lazy_names import import_on_use

if TYPE_CHECKING:
    from ces_data.reading import read_log, read_recording
    from ces_data.recording import Channel, Recording
    from ces_identify.api import (
        compare_models,
        identify,
        make_recording,
        simulate,
        simulate_arrays,
        validate,
        write_recording,
    )
    from ces_identify.characteristics.characterise import characterise
    from ces_identify.characteristics.page import write_characteristics
    from ces_identify.characteristics.rows import Characteristics
    from ces_identify.comparison.comparison import Comparison
    from ces_identify.identification import IdentificationResult
    from ces_identify.numerics.search import Limits
    from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, Simulation
    from ces_identify.structures.kit import IdentifyOptions
    from ces_identify.validation.evaluate import Evaluation
    from ces_observer import Model, load_model

__getattr__ = import_on_use(
    __name__,
    {
    "ces_identify.api": (
        "compare_models", "identify", "make_recording", "simulate", "simulate_arrays", "validate", "write_recording",
    ),
    "ces_identify.characteristics.characterise": ("characterise",),
    "ces_identify.characteristics.page": ("write_characteristics",),
    "ces_identify.comparison.comparison": ("Comparison",),
    "ces_identify.characteristics.rows": ("Characteristics",),
    "ces_identify.identification": ("IdentificationResult",),
    "ces_identify.numerics.search": ("Limits",),
    "ces_data.reading": ("read_log", "read_recording"),
    "ces_data.recording": ("Channel", "Recording"),
    "ces_identify.simulations.simulation": ("FunctionSimulation", "ModelSimulation", "Simulation"),
    "ces_identify.structures.kit": ("IdentifyOptions",),
    "ces_identify.validation.evaluate": ("Evaluation",),
    "ces_observer": ("Model", "load_model"),
    },
)  # fmt: skip

__all__ = [
    "Channel", "Characteristics", "Comparison", "Evaluation", "FunctionSimulation", "IdentificationResult",
    "IdentifyOptions", "Limits", "Model", "ModelSimulation", "Recording", "Simulation", "characterise",
    "compare_models", "identify", "load_model", "make_recording", "read_log", "read_recording", "simulate",
    "simulate_arrays", "validate", "write_characteristics", "write_recording",
]  # fmt: skip
