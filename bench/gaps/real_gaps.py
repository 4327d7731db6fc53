"""Diagnoses of sim-to-real gaps on measured data, printed as the Markdown table of docs/results.md.

    python -m bench.gaps.real_gaps DATA [--only CASE ...] [--threads N]

DATA holds brfd_backlash/*.json and dyke_mr/ranran_50.csv. First, simulations that lack an effect of the real machine:
a band brake without play, and a damper without valve lag. Then an identified model and real recordings with a known
change. A diagnosis takes about a minute; each row is printed when it is ready.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import bench.blas_one_thread  # noqa: F401 - before NumPy
from bench.gaps.effects import CHANGES, Change
from bench.gaps.simulations import BandBrake, StaticMap
from bench.measurement import print_note
from ces_cli.bags import import_
from ces_gap.diagnosis import NO_GAP, UNKNOWN, Diagnosis, Estimate
from ces_gap.pipeline import DiagnoseOptions, diagnose
from ces_identify.identification import identify
from ces_identify.polynomial.search_limits import Limits
from ces_identify.recordings.bag_reader import read_recording
from ces_identify.recordings.recording import Recording
from ces_identify.recordings.signals_file import load_signals
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, Simulation
from ces_identify.structures.kit import IdentifyOptions

ROOT = Path(__file__).resolve().parents[2]
BRFD_BOTH = ("0.25Hz30lbtension1amplitude", "1Hz30lbtension1amplitude")
BRFD_OTHER = ("0.5Hz36lbtension1.5amplitude",)
DYKE = "ranran_50"
FIT_S, REFERENCE_S, REAL_S = (0.0, 7.0), (7.0, 13.0), (13.0, 21.0)  # the damper rests after 21 s
SEARCH = Limits(max_terms=25, seconds=300.0, starts=4, threads=1)  # stops earlier, without candidates left

HEADER = ("simulation and recordings", "in truth", "verdict", "named", "gap N", "left N", "shrink", "parameters")


@dataclass(frozen=True)
class Data:
    """The measured recordings, imported into bags below `bags`."""

    logs: Path
    bags: Path

    def brfd(self, name: str) -> Recording:
        return self._import_log(f"brfd_backlash/{name}.json", "brfd_backlash.yaml")

    def dyke(self) -> Recording:
        return self._import_log(f"dyke_mr/{DYKE}.csv", "dyke_mr.yaml")

    def _import_log(self, log: str, mapping: str) -> Recording:
        """Return a log through a bag, as written by `ces import` and read by `ces diagnose`."""
        bag = self.bags / Path(log).stem
        if not bag.exists():
            words = [str(self.logs / log), "--mapping", str(ROOT / "config" / "import" / mapping), "--out", str(bag)]
            with contextlib.redirect_stdout(sys.stderr):
                import_.main(words)
        return read_recording(bag, load_signals(ROOT / "config" / "signals.yaml"))


@dataclass(frozen=True)
class DiagnosisRow:
    """A diagnosis to run: the simulation and recordings, and the true cause."""

    case: str
    setup: str
    truth: str
    run_diagnosis: Callable[[], Diagnosis]


def brake_without_play(data: Data, names: Sequence[str], threads: int = 1) -> Diagnosis:
    """Diagnose the band brake, fitted to the first of the recordings, on all of them."""
    recordings = [data.brfd(name) for name in names]
    return _run_diagnosis(FunctionSimulation("brake", BandBrake.fit(recordings[0])), recordings, (), threads)


def damper_without_lag(data: Data, threads: int = 1) -> Diagnosis:
    """Diagnose the static map of Dyke's damper, fitted where its voltage had settled."""
    recording = data.dyke()
    return _run_diagnosis(FunctionSimulation("map", StaticMap.fit(recording)), [recording], (), threads)


def with_change(data: Data, change: Change | None, threads: int = 1) -> Diagnosis:
    """Diagnose an identified model on Dyke's damper with a known change; references are without it."""
    recording = data.dyke()
    real = between(recording, *REAL_S)
    changed = real if change is None else change.apply(real)
    return _run_diagnosis(_identify_model(data), [changed], [between(recording, *REFERENCE_S)], threads)


@cache
def _identify_model(data: Data) -> Simulation:
    options = IdentifyOptions(split=1.0, limits=SEARCH)
    return ModelSimulation(identify([between(data.dyke(), *FIT_S)], options=options).model)


def _run_diagnosis(
    simulation: Simulation, real: Sequence[Recording], reference: Sequence[Recording], threads: int
) -> Diagnosis:
    options = DiagnoseOptions(threads=threads, experiment=False)
    return diagnose(simulation, "simulation", real, reference=reference, options=options)


def between(recording: Recording, from_s: float, to_s: float) -> Recording:
    """Return the recording from `from_s` to before `to_s` after the first position."""
    begin = recording.channel("position").stamps_ns[0]
    low, high = (begin + round(1e9 * s) for s in (from_s, to_s))
    channels = {n: c.select((c.stamps_ns >= low) & (c.stamps_ns < high)) for n, c in recording.channels.items()}
    return replace(recording, channels=channels, source="", sha256="")


def rows(data: Data, threads: int) -> list[DiagnosisRow]:
    """Return all diagnoses to run."""
    brake, model = "band brake without play", "Dyke: identified model, change put into the recording"
    found = [
        DiagnosisRow(
            "brfd", f"{brake}, 0.25 and 1 Hz", "backlash", lambda: brake_without_play(data, BRFD_BOTH, threads)
        ),
        DiagnosisRow(
            "brfd_other", f"{brake}, 0.5 Hz", "backlash", lambda: brake_without_play(data, BRFD_OTHER, threads)
        ),
        DiagnosisRow(
            "dyke", "Dyke: static map of speed and voltage", "valve lag", lambda: damper_without_lag(data, threads)
        ),
        DiagnosisRow(
            "none", "Dyke: identified model, recording as it is", "nothing", lambda: with_change(data, None, threads)
        ),
    ]
    for change in CHANGES:
        truth = f"{change.effect.replace('_', ' ')}: {change.words}"
        found.append(DiagnosisRow(change.effect, model, truth, lambda c=change: with_change(data, c, threads)))
    return found


def cells(row: DiagnosisRow, diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return a row of the table."""
    best = diagnosis.composition
    nothing = diagnosis.verdict == NO_GAP
    names = " + ".join(name.replace("_", " ") for name in best.effects) or "nothing"
    names = f"(nearest: {names})" if diagnosis.verdict == UNKNOWN else names
    parameters = "; ".join(_format_estimate(e) for estimates in best.estimates for e in estimates)
    left, shrink = ("", "") if nothing else (f"{best.gap_after_N:,.0f}", f"{100.0 * best.shrink:.0f} %")
    gap = f"{diagnosis.gap.rms_N:,.0f}"
    return row.setup, row.truth, diagnosis.verdict.replace("_", " "), names, gap, left, shrink, parameters


def _format_estimate(estimate: Estimate) -> str:
    low, high = estimate.ci95
    doubt = " at its bound" if estimate.at_bound else ""
    return f"{estimate.name} {estimate.value:.3g} ({low:.3g} to {high:.3g}){doubt}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, metavar="DATA", help="folder of the measured logs")
    parser.add_argument("--only", nargs="+", metavar="CASE", help="brfd, brfd_other, dyke, none, friction, ...")
    parser.add_argument("--threads", type=int, default=1, help="of each diagnosis, default 1")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        known = {row.case: row for row in rows(Data(options.data, Path(folder)), options.threads)}
        chosen = options.only or list(known)
        if missing := set(chosen) - set(known):
            parser.error(f"no case {', '.join(sorted(missing))}; expected {', '.join(known)}")
        print(f"| {' | '.join(HEADER)} |\n|---|---|---|---|---:|---:|---:|---|", flush=True)
        for case in chosen:
            began = time.monotonic()
            print(f"| {' | '.join(cells(known[case], known[case].run_diagnosis()))} |", flush=True)
            print_note(f"{case}: {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
