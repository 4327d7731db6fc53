"""Cases of the band brake: a simulation without play on each recording and pair, and with play as a control."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bench.gaps.independent_values import read_play
from bench.gaps.measured_data import BRAKES, Data
from bench.gaps.real_case import RealCase
from bench.gaps.simulations import BandBrake
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import FunctionSimulation, Simulation


def brake_cases(data: Data) -> list[RealCase]:
    """Return the band brake without play on each recording and pair, and with play as a control."""
    pairs = [("0.25 Hz", "1 Hz"), ("0.25 Hz", "0.5 Hz"), ("0.5 Hz", "1 Hz")]
    groups = [*((name,) for name in BRAKES), *pairs]
    found = [_brake_case(data, group, group[0], 0.0) for group in groups]
    found.append(_brake_case(data, ("1 Hz",), "0.25 Hz", 0.0))
    return [*found, *(_brake_case(data, (name,), name, None) for name in ("0.25 Hz", "0.5 Hz"))]


def _brake_case(data: Data, group: Sequence[str], fitted: str, play_m: float | None) -> RealCase:
    """Return a case of the brake; `play_m` None puts the play that is read from the loops into the simulation."""

    def prepare() -> tuple[Simulation, Sequence[Recording]]:
        play = read_play(data.brake(fitted)) if play_m is None else play_m
        brake = replace(BandBrake.fit(data.brake(fitted)), play_m=play)
        return FunctionSimulation("brake", brake), [data.brake(name) for name in group]

    kind = "with" if play_m is None else "without"
    words = " and ".join(group) + ("" if fitted in group else f", fitted to {fitted}")
    name = "_".join(("brake", *(g.removesuffix(" Hz") for g in group), *(() if fitted in group else ("other",))))
    return RealCase(
        f"{name}_control" if play_m is None else name,
        tuple(BRAKES[g] for g in group),
        f"band brake {kind} play, {words}",
        "nothing of the library" if play_m is None else "play",
        () if play_m is None else ("backlash",),
        prepare,
        lambda: "loops: play " + ", ".join(f"{1e3 * read_play(data.brake(n)):.1f}" for n in group) + " mm",
    )
