"""How well `ces learn-stroke` does: strokes, dampers, actuators, seeds, and models that are 30 % wrong.

`python -m bench.rig.learn_stroke [--write] [--out DIR] [--jobs N] [--only WORD]` prints the tables (synthetic data);
--write puts them into docs/learn-stroke.md, --out writes learn_stroke.csv. Errors are those of a fresh run of the
learned command, noise included.
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np

from bench.markdown import markdown, replace_between
from ces_iterate.stroke.actuator_model import ActuatorModel
from ces_iterate.stroke.goal import LearnedStroke, LearningSettings, StrokeGoal, command_peaks
from ces_iterate.stroke.learning import learn_stroke
from ces_iterate.stroke.limits import StrokeLimits, measure_peaks
from ces_iterate.stroke.page import error_above_bandwidth
from ces_iterate.stroke.rig import INTERVAL_S, VirtualStrokeRig
from ces_rig.drive.servo_actuator import ServoActuator
from ces_rig.experiment import parse_experiment

SECONDS = 5.0
ITERATIONS = 8
MAX_SHARE, MAX_RATIO = 0.1, 1.5  # targets: error over the first one, over the repeatability
TIME = np.arange(round(SECONDS / INTERVAL_S) + 1) * INTERVAL_S
STROKES = {
    "sine 4 Hz": {"kind": "sine", "amplitude_m": 0.0125, "frequency_Hz": 4.0},
    "sweep 2–16 Hz": {"kind": "sweep"},
    "noise to 10 Hz": {"kind": "noise", "cutoff_Hz": 10.0, "peak_to_peak_m": 0.04},
    "road C, 60 km/h": {"kind": "road"},
    "filtered steps": None,
}
DAMPERS = {
    "0.6 A": ({}, {"kind": "constant", "current_A": 0.6}),
    "0.3 A, much friction": ({"seal": {"coulomb_N": 60.0, "static_N": 80.0}}, {"kind": "constant", "current_A": 0.3}),
    "current follows the stroke": ({}, {"kind": "stroke_following"}),
}
ACTUATORS = {
    "default": {},
    "slow": {"bandwidth_Hz": 22.0, "damping": 0.6, "delay_s": 0.006, "valve_s": 0.003, "compliance_m_N": 3e-7},
}
CORNERS = tuple(product((0.7, 1.3), repeat=3))  # of gain, bandwidth and delay of the model
PROBED, CORRECTED, KEPT, TIGHT = "probe", "corrected", "kept", "tight"
TIGHT_ROOM = 1.001  # limits over the peaks of the wanted stroke
MODELS = {
    PROBED: "**Actuator unknown**, identified by the probe:",
    CORRECTED: "**Model 30 % wrong** in gain, bandwidth and delay at once (all eight corners), corrected where runs "
    "show the response, no probe:",
    KEPT: "The same wrong models, **never corrected** (`correct_model: false`): what the robustness alone does.",
    TIGHT: f"Actuator unknown, **tight limits**: stroke, speed and acceleration of every command at most {TIGHT_ROOM} "
    "times those of the wanted stroke. The piston cannot follow where a limit binds; no command leaves the limits.",
}


@dataclass(frozen=True)
class StrokeCase:
    """One learning: stroke, damper and actuator by name, the seed, how the model is known, and its factors."""

    model: str
    stroke: str
    damper: str
    actuator: str
    seed: int
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class StrokeRow:
    """The outcome of a case; errors in µm."""

    case: StrokeCase
    first: float
    last: float
    repeatability: float
    iterations: int
    outside: bool
    bound: float
    true: float
    bandwidth_Hz: float
    above: float
    seconds: float


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--write", action="store_true", help="write the tables into docs/learn-stroke.md")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--only", default="", help="only cases whose model is known in this way: probe, corrected, kept"
    )
    options = parser.parse_args(argv)
    chosen = [case for case in cases() if case.model.startswith(options.only)]
    start = time.perf_counter()
    if options.jobs == 1:
        rows = list(map(run_case, chosen))
    else:
        with ProcessPoolExecutor(options.jobs) as pool:
            rows = list(pool.map(run_case, chosen))
    text = describe(rows)
    print(f"{text}\n{time.perf_counter() - start:.0f} s")
    if options.write:
        replace_between(Path("docs/learn-stroke.md"), "learn-stroke", text.rstrip())
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "learn_stroke.csv").write_text(as_csv(rows))


def cases() -> Iterator[StrokeCase]:
    """Yield all cases: with a probe every stroke, damper and actuator; with wrong models every stroke and corner."""
    for n, (stroke, damper, actuator) in enumerate(product(STROKES, DAMPERS, ACTUATORS)):
        yield StrokeCase(PROBED, stroke, damper, actuator, 1 + n)
    for n, stroke in enumerate(STROKES):
        yield StrokeCase(TIGHT, stroke, "0.6 A", "default", 201 + n)
    dampers, actuators = list(DAMPERS), list(ACTUATORS)
    for model in (CORRECTED, KEPT):
        for n, (stroke, factors) in enumerate(product(STROKES, CORNERS)):
            yield StrokeCase(model, stroke, dampers[n % 3], actuators[(n // 8 + n) % 2], 101 + n, factors)


def run_case(case: StrokeCase) -> StrokeRow:
    start = time.perf_counter()
    damper, current = DAMPERS[case.damper]
    stroke = STROKES[case.stroke] or {"kind": "rest"}
    description = {"duration_s": SECONDS, "seed": case.seed, "stroke": stroke, "current": current, "damper": damper}
    experiment = parse_experiment({**description, "actuator": ACTUATORS[case.actuator]}, case.stroke)
    wanted = experiment.stroke.samples(TIME, np.random.default_rng([case.seed, 0]))
    wanted = make_steps(case.seed) if STROKES[case.stroke] is None else wanted
    truth = true_response(experiment.actuator)
    settings = LearningSettings(max_iterations=ITERATIONS, correct_model=case.model != KEPT)
    model = None if case.model in (PROBED, TIGHT) else truth.scale(*case.factors)
    peaks = TIGHT_ROOM * np.array(measure_peaks(wanted, INTERVAL_S))
    limits = StrokeLimits(*peaks) if case.model == TIGHT else StrokeLimits()
    goal = StrokeGoal(wanted, INTERVAL_S, limits, settings, model=model)
    learned = learn_stroke(VirtualStrokeRig(experiment), goal)
    return make_row(case, learned, truth, time.perf_counter() - start)


def make_row(case: StrokeCase, learned: LearnedStroke, truth: ActuatorModel, seconds: float) -> StrokeRow:
    f = learned.learning_filter
    left = f.share * np.abs(1.0 - f.learning(f.frequency_Hz) * truth.response(f.frequency_Hz))
    return StrokeRow(
        case,
        1e6 * learned.first.error_m,
        1e6 * learned.confirmation.error_m,
        1e6 * learned.repeatability_m,
        learned.iterations,
        any(highest > limit * (1.0 + 1e-9) for _, _, highest, limit in command_peaks(learned)),
        float(f.contraction.max()),
        float(left.max()),
        f.bandwidth_Hz,
        1e6 * error_above_bandwidth(learned),
        seconds,
    )


def true_response(actuator: ServoActuator | None) -> ActuatorModel:
    """Return the actuator of the rig without damper, limits and disturbance as a model."""
    a = actuator or ServoActuator()
    return ActuatorModel(a.gain, a.delay_s, a.bandwidth_Hz, a.damping, a.valve_s)


def make_steps(seed: int) -> np.ndarray:
    """Return steps between random levels up to ±15 mm, each a smooth ramp of 80 ms, that end where they begin."""
    levels = np.random.default_rng(seed).uniform(-0.015, 0.015, 9)
    levels[[0, -1]] = 0.0
    held = np.repeat(levels, round((len(TIME) - 1) / len(levels) + 1))[: len(TIME)]
    window = np.hanning(round(0.08 / INTERVAL_S) + 2)[1:-1]
    padded = np.pad(held, (len(window) // 2, len(window) - 1 - len(window) // 2), mode="edge")
    return np.convolve(padded, window / window.sum(), mode="valid")


def describe(rows: Sequence[StrokeRow]) -> str:
    parts = [
        f"`python -m bench.rig.learn_stroke --write`, virtual rig (synthetic data): {len(rows)} strokes of {SECONDS:g} "
        f"s, at most {ITERATIONS} iterations. Errors: RMS in µm of a fresh run of the learned command, noise included; "
        "median (worst) of the cases. Dampers: "
        + "; ".join(DAMPERS)
        + ". Actuators: the default, and a slower one that "
        "gives way more (22 Hz, damping 0.6, delay 6 ms, valve 3 ms, 0.3 µm/N). Every case has a seed of its own. "
        f"Targets: error at most {MAX_SHARE} of the first *and* at most {MAX_RATIO} times the repeatability. "
        "*Bound*: largest |Q(1 − LG)| for all plants considered; *true*: for the actuator that the rig has (without "
        "damper).\n"
    ]
    for model in dict.fromkeys(row.case.model for row in rows):
        some = [row for row in rows if row.case.model == model]
        parts.append(f"{MODELS[model]}\n\n{markdown(summary(some))}\n")
    return "\n".join(parts)


HEAD = (
    "stroke", "first", "learned", "over first", "over repeatability", "iterations", "both targets", "outside limits",
    "bound", "true",
)  # fmt: skip


def summary(rows: Sequence[StrokeRow]) -> list[Sequence[str]]:
    lines: list[Sequence[str]] = [HEAD]
    for stroke in dict.fromkeys(row.case.stroke for row in rows):
        some = [row for row in rows if row.case.stroke == stroke]
        share, ratio = [r.last / r.first for r in some], [r.last / r.repeatability for r in some]
        met = sum(s <= MAX_SHARE and q <= MAX_RATIO for s, q in zip(share, ratio, strict=True))
        lines.append([
            stroke,
            _pair([r.first for r in some], "{:.0f}"),
            _pair([r.last for r in some], "{:.0f}"),
            _pair(share, "{:.3f}"),
            _pair(ratio, "{:.2f}"),
            _pair([r.iterations for r in some], "{:.0f}"),
            f"{met} of {len(some)}",
            str(sum(r.outside for r in some)),
            f"{max(r.bound for r in some):.2f}",
            f"{max(r.true for r in some):.2f}",
        ])  # fmt: skip
    return lines


def as_csv(rows: Sequence[StrokeRow]) -> str:
    text = io.StringIO()
    records = [{**asdict(row.case), **{k: v for k, v in asdict(row).items() if k != "case"}} for row in rows]
    writer = csv.DictWriter(text, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()


def _pair(values: Sequence[float], form: str) -> str:
    return f"{form.format(float(np.median(values)))} ({form.format(max(values))})"


if __name__ == "__main__":
    main()
