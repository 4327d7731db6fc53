"""Small planted data for hydraulic networks: a rough ride, and the force of a network of known parameters."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from planted import SAMPLING, stroked

from ces_data.recording import Channel
from ces_identify.physical.layout import read_scales
from ces_identify.physical.models import HydraulicModels
from ces_identify.prepare.series import Series, prepare
from ces_identify.training import build_training
from ces_observer.model import Model

KINDS = {"uniflow": 3, "twin tube": 2}  # seeds of the true parameters
NOISE_N = 5.0
SPREAD = 0.4
ROWS = 2
SECONDS = 12.0


@cache
def ride(seed: int, seconds: float = SECONDS) -> Series:
    """A prepared ride whose force is that of a dashpot: it sets scale and envelope of the models."""
    bare = stroked(seed, seconds)
    position = bare.channel("position")
    speed = np.gradient(position.values, position.stamps_ns * 1e-9)
    force = 1200.0 * np.tanh(4.0 * speed) * (0.4 + 0.6 * bare.channel("current").values)
    channel = Channel("force", "N", position.stamps_ns, force)
    return prepare(replace(bare, channels={**bare.channels, "force": channel}), SAMPLING)


@cache
def started(kind: str, bypass: bool = False, seconds: float = SECONDS) -> HydraulicModels:
    """The models from which the fit of a kind starts, on the ride."""
    training = build_training([ride(1, seconds)])
    return HydraulicModels.first(training, read_scales(training, SAMPLING.rate_Hz), kind, ROWS, False, bypass)


@cache
def truth(kind: str, bypass: bool = False, seconds: float = SECONDS) -> tuple[HydraulicModels, np.ndarray]:
    """Models with free nodes, and parameters away from where a fit starts."""
    models, random = started(kind, bypass, seconds), np.random.default_rng(KINDS[kind])
    return models.free(models.layout.centre + SPREAD * random.standard_normal(len(models.layout.centre)))


def planted_models(kind: str, seed: int, noise_N: float = NOISE_N, seconds: float = SECONDS) -> HydraulicModels:
    """The models with the force of the true parameters as the measured one, and noise."""
    models, theta = truth(kind, seconds=seconds)
    force = models.force(theta)
    noise = np.random.default_rng(seed).normal(0.0, noise_N, len(force))
    return replace(models, training=replace(models.training, measured=force + noise))


def planted_model(kind: str, bypass: bool = False) -> Model:
    """The model with the true parameters."""
    models, theta = truth(kind, bypass)
    model = Model(SAMPLING, models.hold_pressures(theta).body(theta), models.training.envelope, (-1e6, 1e6))
    return replace(model, certificate=model.certify().to_mapping())


def planted_series(kind: str, seed: int, noise_N: float = NOISE_N) -> Series:
    """The ride with the force of the planted model and noise."""
    return replace(ride(1), force=planted_models(kind, seed, noise_N).training.measured)
