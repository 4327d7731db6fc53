"""Diagnoses of sim-to-real gaps on measured data without references, as the Markdown table of docs/results.md.

    python -m bench.gaps.real_gaps DATA [--only CASE ...] [--threads N]

DATA holds the folders of the rigs. The simulations lack something known of the
real machine (`real_cases.py`); all options of the diagnosis are the defaults. A
diagnosis takes a second to half a minute of CPU; each row is printed when it is ready.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import bench.blas_one_thread  # noqa: F401 - before NumPy
from bench.gaps.real_cases import (
    Data,
    RealCase,
    brake_cases,
    dyke_cases,
    friction_cases,
    map_cases,
    pressure_cases,
)
from bench.measurement import print_note
from ces_gap.diagnosis import AMBIGUOUS, NO_GAP, UNKNOWN, Diagnosis, Estimate
from ces_gap.inference.judgement import CALIBRATION, TIMING
from ces_gap.pipeline import DiagnoseOptions, diagnose

HEADER = ("simulation and recordings", "in truth", "answer", "judged", "shrink %", "parameters", "independent")
ALIGN = "|---|---|---|---|---:|---|---|"
RIGHT, PARTLY, DOUBT, NOTHING, WRONG = "right", "partly", "in doubt", "none", "**wrong**"


def all_cases(data: Data) -> dict[str, RealCase]:
    """Return all cases by name, in the order of the table."""
    kinds = brake_cases, friction_cases, map_cases, dyke_cases, pressure_cases
    return {case.name: case for cases in kinds for case in cases(data)}


def diagnose_case(case: RealCase, threads: int = 1) -> Diagnosis:
    """Return the diagnosis of a case, without references and with default options."""
    simulation, real = case.prepare()
    options = DiagnoseOptions(threads=threads, experiment=False)
    return diagnose(simulation, "simulation", real, options=options)


def judge(causes: Sequence[str], verdict: str, effects: Sequence[str]) -> str:
    """Return whether a diagnosis names what is physically right.

    A recalibration and the simulation's timing are right where nothing is missing, and no cause elsewhere. `ambiguous`
    is "in doubt" if no right name is among its effects: it does not name one.
    """
    physical = [e for e in effects if e not in (CALIBRATION, TIMING)]
    if verdict in (NO_GAP, UNKNOWN) or (not physical and not causes):
        return NOTHING if causes or verdict == UNKNOWN else RIGHT
    hits = [e for e in physical if e in causes]
    if verdict == AMBIGUOUS:
        return PARTLY if hits else DOUBT
    if not hits:
        return NOTHING if not physical else WRONG
    return RIGHT if len(hits) == len(physical) else PARTLY


def cells(case: RealCase, diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return a row of the table."""
    best = diagnosis.composition
    names = " + ".join(name.replace("_", " ") for name in best.effects) or "nothing"
    if diagnosis.verdict == AMBIGUOUS:
        names += "".join(f" (or {' or '.join(g).replace('_', ' ')})" for g in diagnosis.indistinguishable)
    parameters = "; ".join(
        _format_estimate(e)
        for effect, estimates in zip(best.effects, best.estimates, strict=True)
        for e in estimates
        if effect in case.causes and diagnosis.verdict != UNKNOWN
    )
    shrink = "" if diagnosis.verdict == NO_GAP else f"{100.0 * best.shrink:.0f}"
    judged = judge(case.causes, diagnosis.verdict, best.effects)
    verdict = diagnosis.verdict.replace("_", " ")
    answer = verdict if diagnosis.verdict == UNKNOWN else f"{verdict}: {names}"
    return case.setup, case.truth, answer, judged, shrink, parameters, case.measure()


def _format_estimate(estimate: Estimate) -> str:
    low, high = estimate.ci95
    doubt = " at its bound" if estimate.at_bound else ""
    return f"{estimate.name} {estimate.value:.3g} ({low:.3g}…{high:.3g}){doubt}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, metavar="DATA", help="folder of the measured logs")
    parser.add_argument("--only", nargs="+", metavar="CASE", help="names of cases; a wrong one lists them")
    parser.add_argument("--threads", type=int, default=1, help="of each diagnosis, default 1")
    options = parser.parse_args()
    known = all_cases(Data(options.data))
    chosen = options.only or list(known)
    if missing := set(chosen) - set(known):
        parser.error(f"no case {', '.join(sorted(missing))}; expected {', '.join(known)}")
    print(f"| {' | '.join(HEADER)} |\n{ALIGN}", flush=True)
    for name in chosen:
        began = time.process_time()
        diagnosis = diagnose_case(known[name], options.threads)
        print(f"| {' | '.join(cells(known[name], diagnosis))} |", flush=True)
        print_note(f"{name}: {time.process_time() - began:.0f} s of CPU; {diagnosis.sentence}")


if __name__ == "__main__":
    main()
