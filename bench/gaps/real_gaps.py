"""Diagnoses of sim-to-real gaps on measured data without references, as the Markdown table of docs/results.md.

    python -m bench.gaps.real_gaps DATA [--only CASE ...] [--threads N]

DATA holds the folders of the rigs. The simulations lack something known of the
real machine (`real_cases.py`); all options of the diagnosis are the defaults. A
diagnosis takes a second to half a minute of CPU. Each answer is noted when it is ready; the table has a row for each
simulation and truth, over all its recordings.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

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
from bench.markdown import markdown
from bench.measurement import print_note
from ces_gap.diagnosis import AMBIGUOUS, NO_GAP, UNKNOWN, Diagnosis
from ces_gap.inference.judgement import CALIBRATION, PARAMETERS, TIMING
from ces_gap.pipeline import DiagnoseOptions, diagnose

HEADER = ("simulation", "in truth", "answers", "judged", "shrink %", "parameters")
MEANT = {  # by a parameter of a hydraulic model
    "friction_N": "friction",
    "gas_force_change_N": "force_offset",
    "gas_rate": "gas_spring",
    "leak_m_s_rtN": "leakage",
    "oil_stiffness": "compressibility",
}
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


class CaseAnswer(NamedTuple):
    """The answer to a case: what it is about, the verdict with its effects, and the figures of right effects."""

    setup: str
    truth: str
    answer: str
    judged: str
    shrink: float | None
    parameters: tuple[tuple[str, float], ...]


def read_answer(case: RealCase, diagnosis: Diagnosis) -> CaseAnswer:
    """Return the answer of a diagnosis."""
    best, is_named = diagnosis.composition, diagnosis.verdict not in (UNKNOWN, NO_GAP)
    names = " + ".join(name.replace("_", " ") for name in best.effects)
    if diagnosis.verdict == AMBIGUOUS:
        names += "".join(f" (or {' or '.join(g).replace('_', ' ')})" for g in diagnosis.indistinguishable)
    parameters = tuple(
        (e.name, e.value)
        for effect, estimates in zip(best.effects, best.estimates, strict=True)
        for e in estimates
        if effect in case.causes and diagnosis.verdict != UNKNOWN
    )
    verdict = diagnosis.verdict.replace("_", " ")
    answer = f"{verdict}: {names}" if is_named else verdict
    shrink = None if diagnosis.verdict == NO_GAP else best.shrink
    freed = [
        e.name for effect, of in zip(best.effects, best.estimates, strict=True) if effect == PARAMETERS for e in of
    ]
    named = [*(e for e in best.effects if e != PARAMETERS), *(MEANT[name] for name in freed if name in MEANT)]
    judged = judge(case.causes, diagnosis.verdict, named)
    return CaseAnswer(case.setup, case.truth, answer, judged, shrink, parameters)


def table(answers: Iterable[CaseAnswer]) -> str:
    """Return the table: a row for each simulation (what stands before the comma in a setup) and truth."""
    groups: dict[tuple[str, str], list[CaseAnswer]] = {}
    for one in answers:
        groups.setdefault((one.setup.partition(",")[0], one.truth), []).append(one)
    rows = [HEADER, *((*key, *_summarise(alike)) for key, alike in groups.items())]
    return markdown(rows, left=len(HEADER))


def _summarise(answers: Sequence[CaseAnswer]) -> tuple[str, ...]:
    shrinks = [100.0 * one.shrink for one in answers if one.shrink is not None]
    values: dict[str, list[float]] = {}
    for name, value in (pair for one in answers for pair in one.parameters):
        values.setdefault(name, []).append(value)
    parameters = "; ".join(f"{name} {_span(of, '.3g')}" for name, of in values.items())
    return (
        _count(one.answer for one in answers),
        _count(one.judged for one in answers),
        _span(shrinks, ".0f") if shrinks else "",
        parameters,
    )


def _count(words: Iterable[str]) -> str:
    counts = Counter(words)
    return "; ".join(f"{n} {word}" if sum(counts.values()) > 1 else word for word, n in counts.items())


def _span(values: Sequence[float], digits: str) -> str:
    low, high = f"{min(values):{digits}}", f"{max(values):{digits}}"
    return low if low == high else f"{low}…{high}"


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
    answers = []
    for name in chosen:
        began, case = time.process_time(), known[name]
        diagnosis = diagnose_case(case, options.threads)
        answers.append(read_answer(case, diagnosis))
        print_note(f"{name}: {time.process_time() - began:.0f} s of CPU; {diagnosis.sentence} ({case.measure()})")
    print(table(answers))


if __name__ == "__main__":
    main()
