"""Means of models at the desk: how they are made of fitted models, batch run and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_identify.prepare.series import SimulatedSeries
from ces_identify.structures.kit import Fitter, Size, StructureKit
from ces_observer.errors import CesError, OptionName
from ces_observer.model import Model
from ces_observer.structures.mixture import Mixture, WeightedModel
from ces_observer.structures.structure import OperatingRange
from ces_report.table import Section, parameter_section
from ces_report.typesetting import four_figures

ABOUT = (
    "The force is the mean of these models' forces by weight; each runs on its own past, in its own range of forces."
)
HEADS = ("Model", "Weight", "Size", "Lowest force [N]", "Highest [N]")


def mean_of(models: Sequence[Model], weights: Sequence[float]) -> Model:
    """Return the weighted mean of models on the same samples, with its certificate; means in it are taken apart."""
    members = []
    for model, weight in zip(models, weights, strict=True):
        own = model.body.members if isinstance(model.body, Mixture) else ()
        members += [replace(member, weight=weight * member.weight) for member in own]
        members += [] if own else [WeightedModel(weight, model.body, model.force_envelope_N)]
    lows, highs = zip(*(model.force_envelope_N for model in models), strict=True)
    mean = Model(models[0].sampling, Mixture(tuple(members)), models[0].envelope, (min(lows), max(highs)))
    proof = mean.certify()
    return replace(mean, certificate=proof.to_mapping() if proof.holds else None)


def run_mixture(body: Mixture, within: OperatingRange, inputs: F, segments: I) -> tuple[F, Mask]:
    """Return the mean of the members' batch runs, in the order of operations of the tick, so that all bits agree."""
    from ces_identify.structures import kit_of  # which finds this module

    total = np.zeros(inputs.shape[1])
    for member in body.members:
        run = kit_of(member.body).batch_run
        total += member.weight * run(member.body, member.within(within), inputs, segments)[0]
    low, high = within.force_N
    return np.clip(total, low, high), (total < low) | (total > high)


def mixture_table(body: Mixture, model: Model, runs: Sequence[SimulatedSeries], role: str) -> Section:
    """Return the members with their weights and sizes."""
    rows = [
        (member.body.option, four_figures(member.weight), member.body.size,
         *map(four_figures, member.force_envelope_N))
        for member in body.members
    ]  # fmt: skip
    return parameter_section(ABOUT, HEADS, rows)


def _refuse(sizes: Mapping[str, Size]) -> Fitter:
    auto = OptionName("structure", "auto")
    raise CesError("a mixture is no structure to fit: ", auto, " makes it of the models that it has fitted")


MIXTURE = StructureKit(
    about="mean of several models", body=Mixture, sizes=(), fitter=_refuse, table=mixture_table, batch_run=run_mixture
)
