"""How much of the measured force the band of a model holds on experiments that it was not identified on.

    python -m bench.band_coverage --seeds 11 12 --time 30 --structure auto

For every seed a damper of each kind of the virtual rig is drawn. A model is identified from noise and sweep, and its
band is evaluated on sine 4 Hz, sine 12 Hz and road. The table is Markdown. The law of the band was chosen with the
rig's own damper and seeds 1 and 2 in view; other seeds are a fair test.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ces_identify.identification import identify
from ces_identify.polynomial.search_limits import Limits
from ces_identify.recordings.recording import Recording
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO, select_fitter
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.validation.evaluate import VALIDATION, Evaluation
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.dampers.kinds import HYDRAULIC, KINDS
from ces_rig.experiment import GRID_S, Experiment, find_experiment, load_experiment, measure_signals, run, with_seed
from ces_rig.nested_numbers import replace_numbers
from ces_rig.withheld.plants import draw_plant, simulate_signals

TRAINING, TESTS = ("noise", "sweep"), ("sine_4hz", "sine_12hz", "road")
SIZES = {size.name: size.default for kit in KITS.values() for size in kit.sizes}
VARIED = {  # standard deviation of the logarithm of some numbers of the rig's own damper
    "ces_valve.area_m2": 0.3,
    "ces_valve.pilot_rise_s": 0.3,
    "ces_valve.pilot_fall_s": 0.3,
    "ces_valve.hysteresis_A": 0.3,
    "ces_valve.cracking_high_Pa": 0.3,
    "seal.coulomb_N": 0.15,
    "mount.stiffness_N_m": 0.3,
    "oil.air_fraction": 0.3,
    "piston.bleed_area_m2": 0.3,
    "piston.compression.closing_s": 0.3,
    "piston.blow_off_Pa": 0.3,
    "body.moving_mass_kg": 0.3,
}


def hydraulic_recordings(seed: int) -> dict[str, Recording]:
    """Return the recordings of the rig's damper with varied numbers."""
    rng, damper = np.random.default_rng(seed), Damper()
    numbers = {path: _number(damper, path) * float(np.exp(s * rng.standard_normal())) for path, s in VARIED.items()}
    varied = replace_numbers(damper, {**numbers, "seal.static_N": 1.6 * numbers["seal.coulomb_N"]})
    experiments = {name: _experiment(name, seed) for name in TRAINING + TESTS}
    return {name: run(replace(one, damper=varied)) for name, one in experiments.items()}


def lumped_recordings(kind: str, seed: int) -> dict[str, Recording]:
    """Return the recordings of a drawn damper, with the current of the experiments in its own range."""
    plant, found = draw_plant(kind, np.random.default_rng(seed)), {}
    low, high = plant.current_A
    for name in TRAINING + TESTS:
        one = _experiment(name, seed)
        time = np.arange(round(one.settings.duration_s / GRID_S) + 1) * GRID_S
        streams = (np.random.default_rng([one.settings.seed, stream]) for stream in (0, 1))
        stroke = one.stroke.samples(time, next(streams))
        current = (one.current.samples(time, stroke, next(streams)) - 0.29) / 0.41
        true = simulate_signals(plant, (), time, stroke, low + (high - low) * current)
        found[name] = measure_signals(true, one.sensors, one.settings.seed, name)
    return found


def evaluate_band(recordings: dict[str, Recording], structure: str, seconds: float) -> Sequence[Evaluation]:
    """Return the evaluations on the experiments that were not used."""
    options = IdentifyOptions(split=1.0, limits=Limits(seconds=seconds, threads=2))
    training, tests = ([recordings[name] for name in names] for names in (TRAINING, TESTS))
    result = identify(training, tests, options, fitter=select_fitter(structure, SIZES))
    return [e for e in result.evaluations if e.role == VALIDATION]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[11, 12])
    parser.add_argument("--time", type=float, default=30.0)
    parser.add_argument("--structure", choices=(*KITS, AUTO), default="polynomial")
    options = parser.parse_args()
    print(f"| damper | {' | '.join(TESTS)} |\n|---|{'---:|' * len(TESTS)}")
    for kind in KINDS:
        for seed in options.seeds:
            found = hydraulic_recordings(seed) if kind == HYDRAULIC else lumped_recordings(kind, seed)
            evaluations = evaluate_band(found, options.structure, options.time)
            cells = (f"{100 * (e.coverage or 0.0):.0f} (J {e.cost:.1f})" for e in evaluations)
            print(f"| {kind}, seed {seed} | {' | '.join(cells)} |", flush=True)


def _experiment(name: str, seed: int) -> Experiment:
    one = load_experiment(find_experiment(name))
    return with_seed(one, one.settings.seed + 1000 * seed)


def _number(damper: Damper, path: str) -> float:
    value: Any = damper
    for key in path.split("."):
        value = getattr(value, key)
    return float(value)


if __name__ == "__main__":
    main()
