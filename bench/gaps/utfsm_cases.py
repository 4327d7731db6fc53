"""Cases of UTFSM's damper: at 0 A without friction, and at all currents with maps that have no memory."""

from __future__ import annotations

from collections.abc import Sequence

from bench.gaps import independent_values as read
from bench.gaps.current_maps import Bingham, CurrentMap, SpeedPolynomial
from bench.gaps.measured_data import CURRENTS, FAST, MIDDLE, SLOW, SWEEPS, Data, between
from bench.gaps.real_case import IDENTIFY, RealCase
from ces_identify.identification import identify
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, Simulation

ELASTIC = ("compressibility", "mount_compliance", "friction")  # presliding, oil or bush: a force that builds up with x
OFFSET = ("force_offset", "gas_spring")  # UTFSM's sweeps: 35 N less at mid-loop than its sines, at another stroke
LOOP = (*ELASTIC, "backlash", "cavitation")  # UTFSM's loops have a plateau after the reversal, too


def friction_cases(data: Data) -> list[RealCase]:
    """Return UTFSM's damper at 0 A with simulations without friction, fitted to 10 mm 2 Hz."""
    off = CURRENTS[0]
    targets = {"slow": [f"{SLOW}_{off}"], "fast": [f"{FAST}_{off}"], "sweep": [SWEEPS[0]]}
    targets["sines"] = targets["slow"] + targets["fast"]
    found = [_friction_case(data, name, logs, "viscous damper") for name, logs in targets.items()]
    found += [_friction_case(data, name, targets[name], "cubic polynomial") for name in ("fast", "sweep")]
    return [*found, _friction_case(data, "fast", targets["fast"], "Coulomb damper")]


def _friction_case(data: Data, name: str, logs: Sequence[str], kind: str) -> RealCase:
    def prepare() -> tuple[Simulation, Sequence[Recording]]:
        fitted = data.utfsm(f"{MIDDLE}_{CURRENTS[0]}")
        control = kind == "Coulomb damper"
        cubic = kind == "cubic polynomial"
        damper = SpeedPolynomial.fit(fitted) if cubic else SpeedPolynomial.fit_sliding(fitted, friction=control)
        return FunctionSimulation("damper", damper), [data.utfsm(log) for log in logs]

    swept = SWEEPS[0] in logs
    return RealCase(
        f"0A_{kind.split(maxsplit=1)[0].lower()}_{name}",
        tuple(logs),
        f"UTFSM 0 A: {kind}, {' and '.join(log.removesuffix('_0.00A') for log in logs)}",
        ("elasticity at the reversal" if kind == "Coulomb damper" else "friction") + (", offset" if swept else ""),
        (*(ELASTIC if kind == "Coulomb damper" else ("friction",)), *(OFFSET if swept else ())),
        prepare,
        lambda: _describe_friction(data, logs),
    )


def _describe_friction(data: Data, logs: Sequence[str]) -> str:
    """Return the steps of friction and the offsets relative to the recording that was fitted."""
    recordings = [data.utfsm(log) for log in logs]
    fitted = read.read_offset(data.utfsm(f"{MIDDLE}_{CURRENTS[0]}"))
    steps = ", ".join(f"{read.read_friction(r):.0f}" for r in recordings)
    return f"step {steps} N; offset " + ", ".join(f"{read.read_offset(r) - fitted:.0f}" for r in recordings) + " N"


def map_cases(data: Data) -> list[RealCase]:
    """Return UTFSM's damper at all currents with maps of speed and current, fitted to 10 mm 2 Hz, and a control."""
    targets = {
        "slow": [f"{SLOW}_{c}" for c in CURRENTS],
        "fast": [f"{FAST}_{c}" for c in CURRENTS],
        "sweeps": list(SWEEPS),
    }
    found = [_map_case(data, kind, name, logs) for kind in ("Bingham", "map") for name, logs in targets.items()]

    def prepare() -> tuple[Simulation, Sequence[Recording]]:
        model = identify([between(s, 0.0, 5.0) for s in data.sines(MIDDLE)], options=IDENTIFY).model
        return ModelSimulation(model), [between(s, 5.0, 20.0) for s in data.sines(MIDDLE)]

    sines = tuple(f"{MIDDLE}_{c}" for c in CURRENTS)
    setup = "UTFSM 0 to 1 A: identified model of the first 5 s, the rest of sine_10mm2Hz"
    return [*found, RealCase("map_control", sines, setup, "nothing but the model's error", (), prepare)]


def _map_case(data: Data, kind: str, name: str, logs: Sequence[str]) -> RealCase:
    def prepare() -> tuple[Simulation, Sequence[Recording]]:
        fitted = data.sines(MIDDLE)
        simulation = Bingham.fit(fitted) if kind == "Bingham" else CurrentMap.fit(fitted)
        return FunctionSimulation("map", simulation), [data.utfsm(log) for log in logs]

    title = "Bingham model" if kind == "Bingham" else "map of speed and current"
    return RealCase(
        f"{kind.lower()}_{name}",
        tuple(logs),
        f"UTFSM 0 to 1 A: {title}, {logs[0].rpartition('_')[0]}",
        "elasticity and void at the reversal" + (", offset" if name == "sweeps" else ""),
        (*LOOP, *(OFFSET if name == "sweeps" else ())),
        prepare,
        lambda: f"loop: {read.read_loop_stiffness(data.utfsm(logs[-1])):.1e} N/m at 1 A",
    )
