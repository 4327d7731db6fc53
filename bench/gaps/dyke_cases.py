"""Cases of Dyke's damper: a static map without valve lag, and an identified model with changes in the recording."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from bench.gaps.effects import CHANGES, Change
from bench.gaps.independent_values import read_valve_delay
from bench.gaps.measured_data import DYKE, Data, between
from bench.gaps.real_case import IDENTIFY, RealCase
from bench.gaps.simulations import StaticMap
from ces_identify.identification import identify
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, Simulation

FIT_S, REAL_S = (0.0, 7.0), (7.0, 21.0)  # the damper rests after 21 s


def dyke_cases(data: Data) -> list[RealCase]:
    """Return Dyke's damper with a static map, and an identified model with changes put into the recording."""
    delay = "a static map fits best with the voltage delayed by {:.1f} ms"
    found = []
    for name, (from_s, to_s) in {"all": (0.0, 30.0), "first": (0.0, 10.5), "last": (10.5, 21.0)}.items():

        def prepare(from_s: float = from_s, to_s: float = to_s) -> tuple[Simulation, Sequence[Recording]]:
            part = between(data.dyke(), from_s, to_s)
            return FunctionSimulation("map", StaticMap.fit(data.dyke())), [part]

        def measure(from_s: float = from_s, to_s: float = to_s) -> str:
            return delay.format(1e3 * read_valve_delay(between(data.dyke(), from_s, to_s)))

        words = f"Dyke: static map of speed and voltage, {name} {'of it' if name == 'all' else 'half'}"
        found.append(RealCase(f"dyke_{name}", (DYKE,), words, "valve lag", ("valve_lag",), prepare, measure))
    found.append(_change_case(data, None, inside=False))
    found += [_change_case(data, change, inside=False) for change in CHANGES]
    return [*found, *(_change_case(data, c, inside=True) for c in CHANGES if c.effect in ("friction", "force_scale"))]


def _change_case(data: Data, change: Change | None, inside: bool) -> RealCase:
    """Return an identified model on a changed recording; with `inside`, a model of the changed damper."""

    def prepare() -> tuple[Simulation, Sequence[Recording]]:
        real = change.apply(data.dyke()) if change else data.dyke()
        return _identify_dyke(data, change if inside else None), [between(real, *REAL_S)]

    setup = "Dyke: identified model, " + ("change in both" if inside else "change in the recording")
    if change is None:
        return RealCase("dyke_control", (DYKE,), "Dyke: identified model, as recorded", "nothing", (), prepare)
    truth = f"{change.effect.replace('_', ' ')}: {change.words}"
    name = f"{change.effect}_control" if inside else change.effect
    if inside:
        return RealCase(name, (DYKE,), setup, f"nothing ({truth})", (), prepare)
    return RealCase(name, (DYKE,), setup, truth, (change.effect,), prepare, lambda: change.words)


@cache
def _identify_dyke(data: Data, change: Change | None) -> Simulation:
    """Return a model of the first part of Dyke's recording, as logged or changed."""
    known = change.apply(data.dyke()) if change else data.dyke()
    return ModelSimulation(identify([between(known, *FIT_S)], options=IDENTIFY).model)
