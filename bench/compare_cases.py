"""What compare_results.py runs: inputs that are made once, and cases, each some commands whose results are compared.

Commands run in a folder of their own, beside the folder `inputs`. Searches end by their counts, not by their time. The
diagnosis replaces simulations that take more than 25 ms to run again by a surrogate: those here take less than 5 ms
(the model) or more than 60 ms (the rig), so that the load of the computer does not change the choice.
"""

from __future__ import annotations

import shutil
from math import cos, sin
from pathlib import Path

BAGS, MODELS, BLIND = "../inputs/bags", "../inputs/models", "../inputs/blind/cases/0001"
COUNTED = "--time 3600 --threads 2"  # a search then ends because no candidates are left
STRUCTURES, EXPORTED = ("constructed", "fuzzy", "network"), ("sample", "constructed")

_NEW = "duration_s: 8.0\nstroke: {kind: noise, peak_to_peak_m: 0.07, cutoff_Hz: 8.0}\ncurrent: {kind: binary}\n"
FILES = {
    "new.yaml": _NEW,
    "worn.yaml": _NEW + "damper: {ces_valve: {pilot_rise_s: 0.016, pilot_fall_s: 0.012}}\n",
    "simulation.yaml": "ces_valve: {cracking_high_Pa: 3.8e+06}\noil: {air_fraction: 0.011}\n",
    "campaign.yaml": "bags: {noise: [bags/noise]}\nvalidate: {sine: [bags/sine_4hz]}\nseeds: [1, 2]\n"
    "structures: {polynomial: {terms: [6, 10]}, sigmoid: {units: 3}, anfis: {rules: 3x2}}\n"
    "limits: {seconds: 3600, starts: 1}\n",
    "log.yaml": "time: {column: t_s}\nposition: {column: x_mm, scale: 0.001}\ncurrent: {column: i_A}\n"
    "force: {column: F_kN, scale: 1000.0}\n",
    "log.csv": "t_s,x_mm,i_A,F_kN\n"
    + "".join(f"{k / 1e3},{20 * sin(k / 100):.4f},{0.3 + k / 1e4:.4f},{cos(k / 100):.5f}\n" for k in range(4000)),
}

INPUTS = (
    "rig new.yaml --seed 1 --out new_1",
    "rig new.yaml --seed 2 --out new_2",
    "rig worn.yaml --seed 3 --out worn_1",
    "rig worn.yaml --seed 4 --out worn_2",
    "blind make --out blind --seed 3 --cases 1 --seconds 6 --plants bouc_wen --kind effect --effects current_scale",
)

CASES: dict[str, tuple[str, ...]] = {
    "demo": (
        f"identify {BAGS}/noise {BAGS}/sweep --validate {BAGS}/sine_4hz {BAGS}/road --out model.json "
        f"--report report.html {COUNTED}",
    ),
    "structures": tuple(
        f"identify {BAGS}/noise --validate {BAGS}/sine_4hz --structure {structure} --starts 2 "
        f"--out {number}.json --report {number}.html {COUNTED}"
        for number, structure in enumerate(("sigmoid --units 4", "anfis --rules 4x2"), start=1)
    ),
    "options": (
        f"identify {BAGS}/noise --validate {BAGS}/sine_4hz --terms 6 --starts 2 --construct hysteresis:0.001 "
        "--construct frequency --construct remanence:0.02 --blend speed:-0.3,0.3 --weight zero_crossing=3 "
        f"--out constructed.json --report constructed.html {COUNTED}",
        f"identify {BAGS}/noise --folds 2 --method random --terms 6 --starts 2 --rate 500 --out folds.json {COUNTED}",
    ),
    "campaign": ("identify --campaign ../inputs/campaign.yaml --out campaign --jobs 1",),
    "diagnose_rig": (  # slow to run again, with references: replaced by a surrogate, the repair used
        "diagnose --sim ../inputs/simulation.yaml --real ../inputs/worn_1 --held-out ../inputs/worn_2 "
        "--reference ../inputs/new_1 ../inputs/new_2 --out gap --threads 2",
        "simulate --sim gap/augmented.json ../inputs/worn_2 --out repaired.csv",
        "identify ../inputs/worn_1 --validate ../inputs/worn_2 --teacher gap/augmented.json --terms 6 --starts 2 "
        f"--out repaired.json {COUNTED}",
    ),
    "diagnose_model": (  # quick to run again, without references: proposes an experiment
        f"diagnose --sim {MODELS}/sample.json --real ../inputs/worn_1 ../inputs/worn_2 --out gap --threads 2",
        "rig gap/next_experiment.yaml --out next",
    ),
    "diagnose_recorded": (  # predictions alone
        f"diagnose --sim topic:/sim_force --real {BLIND}/real --held-out {BLIND}/held_out "
        f"--reference {BLIND}/reference --out gap --threads 2",
    ),
    "diagnose_fleet": (
        f"diagnose --sim {MODELS}/sample.json --real ../inputs/worn_1 ../inputs/worn_2 --reference ../inputs/new_1 "
        "--each recording --jobs 1 --out fleet",
    ),
    "blind": (
        "blind make --out cases --seed 5 --cases 2 --seconds 5 --plants bouc_wen calibration --kind effect none "
        "--gap-to-noise 10 --jobs 1",
        "blind run cases --out results --simulation predictions --jobs 1",
        "blind score cases results --out score.md --rows score.csv",
        "simulate --sim cases/cases/0001/baseline.yaml cases/cases/0001/real/r1 --out baseline.csv",
    ),
    "programs": (
        f"info {BAGS}/road {BAGS}/noise",
        f"info {BAGS}/road ../inputs/worn_1 --json",
        "rig ../inputs/worn.yaml --seed 5 --out worn",
        "import ../inputs/log.csv --mapping ../inputs/log.yaml --out imported",
        f"validate {MODELS}/sample.json {BAGS}/road {BAGS}/sine_4hz --weight zero_crossing=3 --report validated.html",
        f"replay {MODELS}/sample.json {BAGS}/road --out replayed",
        f"simulate --sim ../inputs/simulation.yaml {BAGS}/sine_4hz --out rig.csv",
        *(f"simulate --sim {MODELS}/{name}.json ../inputs/worn_1 --out {name}.csv" for name in STRUCTURES),
        *(f"validate {MODELS}/{name}.json --certificate" for name in ("sample", *STRUCTURES)),
    ),
    "export": (  # what the C computes shows in the FMU, which holds the same: needs a C compiler and pip's .[fmi]
        *(f"export {MODELS}/{name}.json --out {name}.{kind}" for name in EXPORTED for kind in ("c", "fmu")),
        *(f"simulate --sim {name}.fmu ../inputs/worn_1 --out {name}.csv" for name in EXPORTED),
    ),
}


def write_inputs(tree: Path, folder: Path) -> None:
    """Write what INPUTS and CASES read into a new folder, bags and models as they are in a source tree."""
    shutil.copytree(tree / "bags", folder / "bags")
    shutil.copytree(tree / "bench" / "fuzz" / "seeds" / "model", folder / "models")
    shutil.copy(tree / "config" / "models" / "sample.json", folder / "models")
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
