"""Small planted data for models with physics inside: a rough ride, and the force of a model of known parameters."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from planted import SAMPLING, stroked

from ces_data.recording import Channel
from ces_identify.physical.layout import read_scales
from ces_identify.physical.models import PhysicalModels
from ces_identify.prepare.series import Series, prepare
from ces_identify.structures.chambers import ChambersModels
from ces_identify.structures.relaxation import RelaxationModels
from ces_identify.trained.training import build_training
from ces_observer.model import Model

KINDS: dict[str, type[PhysicalModels]] = {"relaxation": RelaxationModels, "chambers": ChambersModels}
NOISE_N = 5.0
SPREAD = 0.4
SEEDS = {"relaxation": 3, "chambers": 2}  # of the true parameters


@cache
def ride(seed: int, seconds: float = 20.0) -> Series:
    """A prepared ride whose force is that of a dashpot: it sets scale and envelope of the models."""
    bare = stroked(seed, seconds)
    position = bare.channel("position")
    speed = np.gradient(position.values, position.stamps_ns * 1e-9)
    force = 1200.0 * np.tanh(4.0 * speed) * (0.4 + 0.6 * bare.channel("current").values)
    channel = Channel("force", "N", position.stamps_ns, force)
    return prepare(replace(bare, channels={**bare.channels, "force": channel}), SAMPLING)


@cache
def models_of(kind: str, seed: int = 1) -> PhysicalModels:
    """The models of a structure on the ride."""
    training = build_training([ride(seed)])
    return KINDS[kind](training, read_scales(training, SAMPLING.rate_Hz))


@cache
def true_parameters(kind: str) -> np.ndarray:
    """Parameters away from where a fit starts."""
    return models_of(kind).layout.perturbed(np.random.default_rng(SEEDS[kind]), SPREAD)


def planted_models(kind: str, seed: int, noise_N: float = NOISE_N) -> PhysicalModels:
    """The models with the force of the true parameters as the measured one, and noise."""
    models = models_of(kind)
    force = models.force(true_parameters(kind))
    noise = np.random.default_rng(seed).normal(0.0, noise_N, len(force))
    return replace(models, training=replace(models.training, measured=force + noise))


def planted_model(kind: str) -> Model:
    """The model with the true parameters."""
    models = models_of(kind)
    model = Model(SAMPLING, models.body(true_parameters(kind)), models.training.envelope, (-1e6, 1e6))
    return replace(model, certificate=model.certify().to_mapping())


def planted_series(kind: str, seed: int, noise_N: float = NOISE_N) -> Series:
    """The ride with the force of the planted model and noise."""
    return replace(ride(1), force=planted_models(kind, seed, noise_N).training.measured)
