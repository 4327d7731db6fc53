"""A cheap stand-in for the diagnosis: the gap as it is, blamed on an offset. And small recordings of a fleet."""

from dataclasses import dataclass

import numpy as np

from ces_data.recording import Channel, Recording
from ces_gap.diagnosis import NAMED, NO_GAP, Diagnosis, Estimate, Explanation, Gap, Where
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.errors import GapError
from ces_gap.trace import make_trace

RATE = 200.0
OFFSETS_N = {"a": 0.0, "b": 40.0, "c": 90.0}


@dataclass(frozen=True)
class Options:
    """As the diagnosis' own."""

    effects: tuple[Effect, ...] = ()
    threads: int = 1
    seed: int = 1
    tolerance: float | None = None


@dataclass(frozen=True)
class Offset(Effect):
    """A force that is always there."""

    name, form = "stand_in_offset", "constant"
    parameters = (EffectParameter("offset_N", -1e3, 1e3, (10.0,), "of the force", magnitude=True),)

    def respond(self, trace, inputs, force, values):
        return force + values[0]


def damper(time_s, position_m, current_A):
    return 1200.0 * np.gradient(position_m, time_s) * (0.5 + current_A)


def made(name, offset_N, seed=1, seconds=3.0):
    """A recording of the damper with an offset on its force."""
    t = np.arange(round(seconds * RATE)) / RATE
    position = 0.01 * np.sin(2 * np.pi * 2.0 * t + seed) + 0.003 * np.sin(2 * np.pi * 5.3 * t)
    current = 0.5 + 0.1 * np.sin(2 * np.pi * 0.7 * t)
    force = damper(t, position, current) + offset_N + np.random.default_rng(seed).normal(0.0, 3.0, len(t))
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    columns = {"position": ("m", position), "current": ("A", current), "force": ("N", force)}
    channels = {key: Channel(key, unit, stamps, values) for key, (unit, values) in columns.items()}
    return Recording(name, channels, sha256=f"{name} {offset_N} {seed}")


def diagnose(simulation, spec, real, held_out, reference, options, progress=lambda what, share: None):
    """Return the gap's RMS and mean; refuses a recording called "refused", and one called "broken" breaks it."""
    names = [r.name for r in real]
    if "refused" in names:
        raise GapError("refused: too short")
    if "broken" in names:
        raise ZeroDivisionError("by zero")
    traces = [make_trace(r, simulation.force(r)) for r in real]
    gap = np.concatenate([(t.force - t.simulated)[t.usable] for t in traces])
    offset, rms = float(gap.mean()), float(np.sqrt(np.mean(gap**2)))
    composition = Composition((Setting(Offset(), (offset,)),) if rms > 10.0 else ())
    estimates = ((Estimate("offset_N", offset, (offset - 1.0, offset + 1.0)),),)
    after, shrink = float(gap.std()), 1.0 - float(gap.std()) / rms
    alone = Explanation(
        ("stand_in_offset",),
        ("constant",),
        Composition((Setting(Offset(), (offset,)),)),
        estimates,
        after,
        shrink,
        (shrink - 0.1, shrink + 0.1),
        probability=0.9,
    )
    together = alone if composition.settings else Explanation((), (), composition, (), rms, 0.0, (0.0, 0.0))
    where = Where((), None, 1.0, ())
    return Diagnosis(
        verdict=NAMED if composition.settings else NO_GAP,
        sentence=f"the gap is {rms:.1f} N",
        simulation=spec,
        gap=Gap(rms, (rms - 1.0, rms + 1.0), 3.0, 1.0, rms, (rms - 1.0, rms + 1.0)),
        where=where,
        causes=(alone,),
        composition=together,
        indistinguishable=(),
        not_separable=(),
        invisible=(),
        ceiling_after_N=after,
        no_gap_reason="",
        tolerance_N=5.0,
        visible_from_N=8.0,
        probability_none=0.1,
        probability_unknown=0.0,
        rest=None,
        next_experiment=None,
        is_recorded=False,
        held_out=(),
    )


def files(diagnosis, sim, sources, facts=None):
    """Return two small files."""
    roles = {role: [r.name for r in recordings] for role, recordings in sources}
    return {"gap.json": f'{{"rms_N": {diagnosis.gap.rms_N:.6f}}}\n', "report.html": f"<p>{sim['spec']} {roles}</p>\n"}
