"""Small recurrent networks for tests."""

from __future__ import annotations

import numpy as np
from samplings import make_sampling

from ces_observer.model import Envelope, Model
from ces_observer.structures.recurrent import CURRENT, MOTION, Member, Recurrent, ScaledInput, Stage

SAMPLING = make_sampling()
ENVELOPE = Envelope((-0.1, 0.1), (-1.0, 1.0), (0.0, 1.0))


def make_stage(dice: np.random.Generator, inputs: int, filters: int, tanhs: int, outputs: int) -> Stage:
    states = 2 * filters + inputs
    sizes = (2 * filters * inputs, tanhs * states, tanhs, outputs * (tanhs + states), outputs)
    rows = [
        dice.uniform(2e-3, 0.1, filters),
        dice.normal(0.0, 20.0, filters),
        *(dice.normal(0.0, 0.3, n) for n in sizes),
    ]
    return Stage(*(tuple(row.tolist()) for row in rows))


def make_recurrent(seed: int = 1, members: int = 2, current: bool = True) -> Recurrent:
    dice = np.random.default_rng(seed)
    networks = tuple(
        Member(
            make_stage(dice, 4, 3, 5, 2),
            make_stage(dice, 2, 2, 4, 3 if current else 1),
            make_stage(dice, 1, 1, 3, 2) if current else None,
        )
        for _ in range(members)
    )
    spreads = (0.3, 0.5, 0.4, 0.03)
    motion = tuple(ScaledInput(name, 0.01, spread) for name, spread in zip(MOTION, spreads, strict=True))
    return Recurrent(400.0, 0.02, motion, (ScaledInput(CURRENT, 0.5, 0.3),) if current else (), networks)


def recurrent_model(body: Recurrent | None = None, **changes) -> Model:
    return Model(**{"sampling": SAMPLING, "body": body or make_recurrent(), "envelope": ENVELOPE,
                    "force_envelope_N": (-9e3, 9e3)} | changes)  # fmt: skip
