"""The cases of measured machines: what is missing from each simulation on purpose, and the logs that show it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from bench.gaps import effects as read
from bench.gaps.effects import CHANGES, Change, read_play, read_valve_delay
from bench.gaps.simulations import BandBrake, Bingham, CurrentMap, SpeedPolynomial, StaticMap
from bench.measured.cases import dissipative
from ces_data.reading import read_log
from ces_data.recording import Recording
from ces_identify.identification import identify
from ces_identify.numerics.search import Limits
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, Simulation
from ces_identify.structures.auto import default_sizes, select_fitter
from ces_identify.structures.kit import IdentifyOptions

SEARCH = Limits(terms=25, time=300.0, starts=4, threads=1)  # stops earlier, without candidates left
IDENTIFY = IdentifyOptions(split=1.0, limits=SEARCH)  # of models that serve as simulations


@dataclass(frozen=True)
class RealCase:
    """A simulation and recordings: what it lacks in truth, names that are right, and an independent value.

    Without names (`causes`), it lacks nothing.
    """

    name: str
    logs: tuple[str, ...]  # stems of the files that are diagnosed
    setup: str
    truth: str
    causes: tuple[str, ...]
    prepare: Callable[[], tuple[Simulation, Sequence[Recording]]]
    measure: Callable[[], str] = lambda: ""


ROOT = Path(__file__).resolve().parents[2]
BRAKES = {
    "0.25 Hz": "0.25Hz30lbtension1amplitude",
    "0.5 Hz": "0.5Hz36lbtension1.5amplitude",
    "1 Hz": "1Hz30lbtension1amplitude",
}
DYKE = "ranran_50"
CURRENTS = ("0.00A", "0.25A", "0.50A", "0.75A", "1.00A")
SLOW, MIDDLE, FAST = "sine_25mm0x5Hz", "sine_10mm2Hz", "sine_5mm4Hz"
SWEEPS = tuple(f"sweep_15Hz_{current}" for current in ("0.0A", "0.5A", "1.0A"))


@dataclass(frozen=True)
class Data:
    """The measured recordings in the folder `logs`."""

    logs: Path

    def brake(self, name: str) -> Recording:
        """Return a recording of the band brake, by its frequency."""
        return _read(self.logs / "brfd_backlash" / f"{BRAKES[name]}.json")

    def dyke(self) -> Recording:
        return _read(self.logs / "dyke_mr" / f"{DYKE}.csv")

    def utfsm(self, name: str) -> Recording:
        """Return a sweep or a sine of UTFSM's damper."""
        return _read(self.logs / "utfsm_mr" / f"{name}.csv")

    def sines(self, stroke: str) -> list[Recording]:
        """Return the five sines of a stroke, by rising current."""
        return [self.utfsm(f"{stroke}_{current}") for current in CURRENTS]


@cache
def _read(log: Path) -> Recording:
    """Return a log, with the mapping that is named for its folder."""
    return read_log(log, mapping=ROOT / "config" / "import" / f"{log.parent.name}.yaml")


def between(recording: Recording, from_s: float, to_s: float) -> Recording:
    """Return the recording from `from_s` to before `to_s` after the first position."""
    begin = recording.channel("position").stamps_ns[0]
    low, high = (begin + round(1e9 * s) for s in (from_s, to_s))
    channels = {n: c.select((c.stamps_ns >= low) & (c.stamps_ns < high)) for n, c in recording.channels.items()}
    return replace(recording, channels=channels, source="", sha256="")


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


FIT_S, REAL_S = (0.0, 7.0), (7.0, 21.0)  # the damper rests after 21 s


def dyke_cases(data: Data) -> list[RealCase]:
    """Return Dyke's damper with a static map, and an identified model with changes put into the recording."""
    delay = "best delay of a static map: {:.1f} ms"
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
    return RealCase(name, (DYKE,), setup, truth, (change.effect,), prepare)


@cache
def _identify_dyke(data: Data, change: Change | None) -> Simulation:
    """Return a model of the first part of Dyke's recording, as logged or changed."""
    known = change.apply(data.dyke()) if change else data.dyke()
    return ModelSimulation(identify([between(known, *FIT_S)], options=IDENTIFY).model)


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


PRESSURES = {  # folder, stems at one gas pressure and at another, what differs, and the names that are right
    "gas": (
        "racing_dyno",
        "t1_1_1_18_18_s5_n10_150psi",
        "t1_2_2_18_18_s5_n10_50psi",
        "other valves, 50 psi of gas",
        (),
    ),
    "seal": ("pneumatic_friction", "1_O-ring257_1bar", "1_O-ring257_5bar", "5 bar", ("friction", *OFFSET)),
}


def pressure_cases(data: Data) -> list[RealCase]:
    """Return hydraulic models of a damper and of a cylinder at one pressure, with recordings at another.

    The racing damper has other settings of its valves, too: a recalibration is right.
    """
    return [_pressure_case(data, name, *how) for name, how in PRESSURES.items()]


def _pressure_case(
    data: Data, name: str, folder: str, fitted: str, other: str, words: str, causes: tuple[str, ...]
) -> RealCase:
    def recording(stem: str) -> Recording:
        return dissipative(_read(data.logs / folder / f"{stem}.csv"))

    def prepare() -> tuple[Simulation, Sequence[Recording]]:
        fitter = select_fitter("hydraulic", default_sizes())
        model = identify([recording(fitted)], options=IDENTIFY, fitter=fitter).model
        return ModelSimulation(model), [recording(other)]

    def measure() -> str:
        return f"offset {read.read_offset(recording(other)) - read.read_offset(recording(fitted)):.0f} N"

    return RealCase(f"pressure_{name}", (other,), f"{folder}: model of {fitted}", words, causes, prepare, measure)
