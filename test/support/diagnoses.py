"""One diagnosis of each verdict, made up around a damper in memory with seal friction that its simulation lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from example_effects import Friction
from hydraulic_models import make_hydraulic
from made_recordings import recording_of
from physical_models import PLAIN_VALVE

from ces_data.arrays import F
from ces_gap.baseline.learner import make_white_noise
from ces_gap.baseline.twin import Twin
from ces_gap.diagnosis import (
    AMBIGUOUS,
    NAMED,
    NO_GAP,
    UNKNOWN,
    Diagnosis,
    Estimate,
    Explanation,
    Gap,
    HeldOutSeries,
    NextExperiment,
    Where,
)
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.inference.judgement import Doubt
from ces_gap.regions.locate import locate
from ces_gap.trace import make_trace

NOISE_N = 8.0
COULOMB_N, TRANSITION = 38.0, 0.012  # [N], [m/s] of the withheld friction
FRICTION = (Estimate("coulomb_N", 36.86, (35.1, 38.4)), Estimate("transition_m_s", 0.013, (0.0104, 0.0159)))
LAG = (Estimate("rise_s", 0.0213, (0.0171, 0.0255)),)
WIDTH = (Estimate("width_A", 0.112, (0.071, 0.157), drifts=True),)
BOUND = (Estimate("rise_s", 0.1, (0.094, 0.1), at_bound=True),)


class ValveLag(Effect):
    """A valve lag for tests; only its name and parameters matter."""

    name, form = "valve_lag", "first order"
    parameters = (EffectParameter("rise_s", 0.0, 0.1, (0.01,), "time constant of a rising force", magnitude=True),)


class Hysteresis(Effect):
    """A magnetic hysteresis for tests; only its name and parameters matter."""

    name, form = "current_hysteresis", "play"
    parameters = (EffectParameter("width_A", 0.0, 0.5, (0.05,), "width of the play in the current", magnitude=True),)


def series(
    name: str, seed: int, coulomb_N: float = COULOMB_N, own: float = 1.0, seconds: float = 10.0
) -> HeldOutSeries:
    """Return a recording with `coulomb_N` of friction that the simulation lacks, which is `own` times off itself."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 0.002)
    position = 0.02 * np.sin(2 * np.pi * 1.7 * time + seed) + 0.008 * np.sin(2 * np.pi * 5.1 * time)
    speed = np.gradient(position, time)
    current = np.repeat(rng.uniform(0.1, 1.5, len(time) // 250), 250)
    error = own * own_error(speed, current)
    simulated = damping(position, speed, current)
    force = simulated + error + coulomb_N * np.tanh(speed / TRANSITION) + NOISE_N * rng.normal(size=len(time))
    made = recording_of(time, name, position=position, current=current, force=force)
    trace = make_trace(replace(made, sha256="5a" * 32), simulated)
    corrected = trace.simulated + own * own_error(trace.inputs.speed, trace.inputs.current)
    effect = Composition((Setting(Friction(), (0.97 * coulomb_N, 0.013)),))
    return HeldOutSeries(trace, corrected, effect.respond(trace, trace.inputs, corrected))


def damping(position: F, speed: F, current: F) -> F:
    return np.asarray((500.0 + 700.0 * current) * np.tanh(speed / 0.12) + 450.0 * speed + 3000.0 * position)


def own_error(speed: F, current: F) -> F:
    return np.asarray(14.0 * np.sin(9.0 * speed) + 6.0 * current)


def located(held_out: Sequence[HeldOutSeries], kept: str = "simulated") -> Where:
    """Return where measured minus `kept` (simulated or corrected) lies."""
    simulated = {"simulated": [s.trace.simulated for s in held_out], "corrected": [s.corrected for s in held_out]}
    gap = [s.trace.force - force for s, force in zip(held_out, simulated[kept], strict=True)]
    return locate([s.trace for s in held_out], gap, make_white_noise(NOISE_N))


@cache
def named() -> Diagnosis:
    held_out = (series("bags/held_out_road", 1), series("bags/held_out_noise", 2))
    where = located(held_out)
    friction = explained(Setting(Friction(), (36.86, 0.013)), FRICTION, held_out, 0.94)
    after = tuple((r, 0.14 * r.rms_N + 0.4) for r in where.regions[:8])
    lag = replace(explained(Setting(ValveLag(), (0.0213,)), LAG, held_out, 0.02), gap_after_N=28.4, shrink=0.213)
    width = replace(explained(Setting(Hysteresis(), (0.112,)), WIDTH, held_out, 0.01), gap_after_N=33.0, shrink=0.086)
    lag, width = replace(lag, shrink_ci95=(0.13, 0.29)), replace(width, shrink_ci95=(0.0, 0.17))
    return Diagnosis(
        verdict=NAMED,
        sentence="The simulation lacks seal friction: adding it closes 89 % of the gap on recordings it never saw.",
        simulation="model.json",
        gap=Gap(40.0, (37.6, 42.6), NOISE_N, 5.31, 36.1, (33.9, 38.5), "repeated cycles"),
        where=where,
        causes=(friction, lag, width),
        composition=friction,
        by_region=after,
        indistinguishable=(),
        not_separable=(),
        invisible=(
            ("bump_stop", "the stroke never comes within 10 mm of its ends"),
            ("temperature_fade", "the oil warms by less than 2 K"),
        ),
        ceiling_after_N=4.0,
        no_gap_reason="",
        tolerance_N=5.0,
        visible_from_N=8.0,
        probability_none=0.01,
        probability_unknown=0.02,
        rest=None,
        next_experiment=experiment(),
        is_recorded=False,
        held_out=held_out,
        notes=("bags/held_out_noise: 0.4 % of the position samples were left out as outliers.",),
    )


@cache
def pair() -> Diagnosis:
    """Return the named one with a second effect beside friction, both fitted together."""
    first = named()
    both = Composition((Setting(Friction(), (35.2, 0.012)), Setting(ValveLag(), (0.011,))))
    composition = replace(
        first.composition,
        effects=("friction", "valve_lag"),
        forms=("coulomb", "first order"),
        composition=both,
        estimates=(
            (Estimate("coulomb_N", 35.2, (33.0, 37.1)), FRICTION[1]),
            (Estimate("rise_s", 0.011, (0.008, 0.014)),),
        ),
        gap_after_N=1.2,
        shrink=0.97,
        shrink_ci95=(0.94, 0.99),
    )
    sentence = "The simulation lacks seal friction and a valve lag: together they close 97 % of the gap."
    return replace(first, sentence=sentence, composition=composition)


@cache
def ambiguous() -> Diagnosis:
    first = named()
    lag, width = (replace(c, gap_after_N=6.1, shrink=0.85, shrink_ci95=(0.79, 0.9)) for c in first.causes[1:])
    causes = (
        replace(lag, probability=0.46),
        replace(width, probability=0.41),
        replace(first.causes[0], probability=0.03, gap_after_N=24.8, shrink=0.38, shrink_ci95=(0.31, 0.45)),
    )
    return replace(
        first,
        verdict=AMBIGUOUS,
        sentence="Valve lag or current hysteresis: these recordings cannot tell the two apart.",
        simulation="topic:/simulation/force",
        gap=replace(first.gap, corrected_N=first.gap.rms_N, corrected_ci95_N=first.gap.ci95_N),
        causes=causes,
        composition=causes[0],
        indistinguishable=(("valve_lag", "current_hysteresis"),),
        doubt=Doubt.ALTERNATIVES,
        alternatives=("current_hysteresis",),
        not_separable=("force_scale", "gas_spring", "leakage"),
        probability_none=0.04,
        probability_unknown=0.06,
        next_experiment=replace(experiment(), separates=("valve_lag", "current_hysteresis"), distance_N=31.0),
        is_recorded=True,
        twin=Twin(make_hydraulic(PLAIN_VALVE, kind="twin tube"), 1e-3, 2.7),
    )


@cache
def unknown() -> Diagnosis:
    first = named()
    lag = replace(first.causes[1], estimates=(BOUND,), gap_after_N=29.0, shrink=0.197, probability=0.06)
    return replace(
        first,
        verdict=UNKNOWN,
        sentence="None of the known effects: together they close 28 % of the gap, a learner without physics 81 %.",
        causes=(lag, *first.causes[2:]),
        composition=lag,
        ceiling_after_N=7.6,
        probability_none=0.01,
        probability_unknown=0.92,
        rest=located(first.held_out, "corrected"),
    )


@cache
def no_gap() -> Diagnosis:
    first = named()
    held_out = tuple(series(name, seed, coulomb_N=0.0, own=0.1) for name, seed in (("bags/road", 3), ("bags/noise", 4)))
    nothing = Explanation((), (), Composition(), (), 0.6, float("nan"), (float("nan"), float("nan")))
    return replace(
        first,
        verdict=NO_GAP,
        sentence="No gap: beyond measurement noise and the simulation's own error nothing is left to explain.",
        gap=Gap(2.1, (0.0, 3.4), NOISE_N, 1.06, 0.6, (0.0, 1.9)),
        where=replace(located(held_out), max_p_value=0.63),
        causes=(),
        composition=nothing,
        ceiling_after_N=0.5,
        probability_none=0.97,
        probability_unknown=0.03,
        next_experiment=None,
        held_out=held_out,
        notes=(),
    )


def explained(
    one: Setting, estimates: tuple[Estimate, ...], held_out: tuple[HeldOutSeries, ...], probability: float
) -> Explanation:
    """Return one effect alone, closing most of the gap."""
    return Explanation(
        effects=(one.name,),
        forms=(one.effect.form,),
        composition=Composition((one,)),
        estimates=(estimates,),
        gap_after_N=4.5,
        shrink=0.875,
        shrink_ci95=(0.85, 0.92),
        gain=0.87,
        gain_error=0.02,
        probability=probability,
    )


def experiment() -> NextExperiment:
    """Return a slow triangle with current steps."""
    time = np.arange(0.0, 20.0, 0.01)
    position = 0.02 * (2.0 / np.pi) * np.arcsin(np.sin(2 * np.pi * 0.25 * time))
    current = np.where(np.floor(time / 4.0) % 2 == 0, 0.3, 1.2)
    recipe = {
        "duration_s": 20.0,
        "stroke": {"kind": "triangle", "amplitude_m": np.float64(0.02), "frequency_Hz": 0.25},
        "current": {"kind": "steps", "levels_A": np.array([0.3, 1.2]), "hold_s": 4},
    }
    purpose = "A slow triangle shows friction as a step in force at each reversal, free of everything that needs speed."
    return NextExperiment("slow_triangle", purpose, recipe, time, position, current)


ALL = {NAMED: named, AMBIGUOUS: ambiguous, UNKNOWN: unknown, NO_GAP: no_gap}
