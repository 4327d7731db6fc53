"""What is recorded: files that are written first, and for each case the commands of `ces`, run one after the other.

A case runs in a folder of its own beside the folder `inputs`. Options have the names that they had at the baseline;
RENAMED has their later names, so that one table records every version.
"""

from __future__ import annotations

from math import cos, sin

RENAMED: dict[
    str, str
] = {}  # option at the baseline: its name now; used where `ces PROGRAM --help` has only the new one

_NEW = "duration_s: 6.0\nstroke: {kind: noise, peak_to_peak_m: 0.07, cutoff_Hz: 8.0}\ncurrent: {kind: binary}\n"
_SINES = """\
duration_s: 9.0
seed: 3
stroke: {kind: sequence, parts: [{kind: sine, amplitude_m: 0.01, frequency_Hz: 3.0, duration_s: 2.0},
  {kind: sine, amplitude_m: 0.015, frequency_Hz: 4.0, duration_s: 3.0},
  {kind: triangle, amplitude_m: 0.03, speed_m_s: 0.2, duration_s: 4.0}]}
current: {kind: sequence, parts: [{kind: steps, levels_A: [0.3, 0.7], hold_s: 1.0, duration_s: 2.0},
  {kind: steps, levels_A: [0.3, 0.5, 0.7], hold_s: 1.0, duration_s: 3.0},
  {kind: steps, levels_A: [0.3, 0.7, 0.3, 0.3, 0.7, 0.3], hold_s: 0.3, duration_s: 4.0}]}
"""
_ROWS = [(k / 500, 20 * sin(k / 50), 0.4 + 0.2 * (k // 300 % 2), cos(k / 50) + 0.1 * sin(k / 7)) for k in range(3000)]
_LIMITS = (
    "{stroke_m: 0.02, speed_m_s: 0.7, acceleration_m_s2: 60.0, low_A: 0.3, high_A: 0.7, frequency_Hz: 12.0, "
    "hold_s: 0.03}"
)
FILES = {
    "new.yaml": _NEW,
    "worn.yaml": _NEW + "damper: {ces_valve: {pilot_rise_s: 0.016, pilot_fall_s: 0.012}}\n",
    "long.yaml": _NEW.replace("6.0", "9.0") + "damper: {oil: {air_fraction: 0.03}}\n",
    "actuated.yaml": _NEW + "actuator: {}\n",
    "bouc_wen.yaml": "kind: bouc_wen\n",
    "sines.yaml": _SINES,
    "damper.yaml": "ces_valve: {cracking_high_Pa: 3.8e+06}\noil: {air_fraction: 0.011}\n",
    "passive.py": "import numpy as np\n\n\ndef force(time_s, position_m, current_A):\n"
    "    return 1500.0 * np.gradient(position_m, time_s) * (0.5 + current_A)\n",
    "campaign.yaml": "bags: {new: [new_1]}\nvalidate: {second: [new_2]}\nseed: [1, 2]\n"
    "structures: {polynomial: {terms: [3, 5]}, sigmoid: {units: 2}}\nlimits: {time: 3600, starts: 1}\n",
    "iterate.yaml": f"limits: {_LIMITS}\nrig: {{kind: virtual}}\nexperiments: {{duration_s: 3.0}}\n"
    "stop: {budget_s: 6.0}\nidentify: {structure: polynomial, terms: 4, starts: 1, threads: 1, time: 3600}\n",
    "stroke.yaml": "experiment: short.yaml\nactuator: {}\nlimits: {stroke_m: 0.05, speed_m_s: 1.5, "
    "acceleration_m_s2: 200.0}\nprobe: {duration_s: 4.0, to_Hz: 40.0}\nlearning: {max_iterations: 2, repeats: 2}\n",
    "short.yaml": "duration_s: 3.0\nseed: 5\nstroke: {kind: sine, amplitude_m: 0.01, frequency_Hz: 3.0}\n"
    "current: {kind: constant, current_A: 0.5}\n",
    "log.yaml": "time: {column: t_s}\nposition: {column: x_mm, scale: 0.001}\ncurrent: {column: i_A}\n"
    "force: {column: F_kN, scale: 1000.0}\n",
    "log.csv": "t_s,x_mm,i_A,F_kN\n" + "".join(f"{t:.3f},{x:.4f},{i:.4f},{f:.5f}\n" for t, x, i, f in _ROWS),
    "german.csv": "Zeit [s];Weg [mm];Strom [A];Kraft [N]\n"
    + "".join(f"{t:.3f};{x:.4f};{i:.4f};{1e3 * f:.2f}\n".replace(".", ",") for t, x, i, f in _ROWS),
    "unclear.csv": "a,b,c\n" + "".join(f"{t:.3f},{x:.4f},{f:.5f}\n" for t, x, _, f in _ROWS[:200]),
    "broken.csv": "time_s,position_m,current_A,force_N\n0.0,0.0,0.3,1\n0.1,abc,0.3,2\n0.2,0.0,0.3,3\n",
    "signals.yaml": "/**:\n  ros__parameters:\n    position: {topic: joint_states, field: 'position[front]'}\n",
    "typo.yaml": "/**:\n  ros__parameters:\n    positon: {topic: joint_states}\n",
    "broken.json": '{"schema": "ces-model/1", "structure": ',
    "not_yaml.yaml": "stroke: {kind: sine\n",
    "unknown_key.yaml": "duration_s: 3.0\nstroke: {kind: sine, amplitude: 0.01}\ncurrent: {kind: binary}\n",
}
INPUTS = (
    "rig new.yaml --seed 1 --out new_1",
    "rig new.yaml --seed 2 --out new_2 --json",
    "rig worn.yaml --seed 3 --out worn_1",
    "rig worn.yaml --seed 4 --out worn_2",
    "rig actuated.yaml --seed 5 --out actuated",
    "rig long.yaml --seed 6 --out long",
    "rig sines.yaml --out sines",
    "identify new_1 --terms 5 --starts 2 --threads 1 --out poly.json --report poly.html",
)

PROGRAMS = (
    "info", "signals", "import", "characterise", "rig", "learn-stroke", "identify", "iterate", "validate", "compare",
    "serve", "replay", "simulate", "export-data", "export", "diagnose", "blind", "blind make", "blind run",
    "blind score", "schema", "completion",
)  # fmt: skip
SCHEMAS = (
    "signals", "import", "candidates", "campaign", "experiment", "damper", "iterate", "learn-stroke", "observer",
    "controller", "rig-node", "identify-node",
)  # fmt: skip
STRUCTURES = ("network", "fuzzy", "constructed", "hydraulic", "hydraulic_bypass", "band")  # of models/
IN, M = "../inputs", "../inputs/models"
NEW, WORN = f"{IN}/new_1", f"{IN}/worn_1 {IN}/worn_2"
SEARCH = "--starts 1 --threads 1"

CASES: dict[str, tuple[str, ...]] = {
    "help": ("--help", *(f"{name} --help" for name in PROGRAMS), "--version", "--version --json", "rig --list",
             "identify --show-candidates", "identify --show-candidates --method thesis", "import --template",
             "iterate --template", "rig --list --json", "help blind"),
    "schema": ("schema --list", "schema --list --json", *(f"schema {name}" for name in SCHEMAS),
               *(f"completion {shell}" for shell in ("bash", "zsh", "fish"))),
    "info": (f"info {IN}/bags/sine_4hz {NEW}", f"info {NEW} {IN}/sines --json", f"signals {IN}/bags/sine_4hz",
             f"signals {NEW} --out signals.yaml", f"signals {NEW} --json"),
    "import": (f"import {IN}/log.csv --mapping {IN}/log.yaml --out mapped", f"import {IN}/german.csv --out german",
               f"import {IN}/log.csv --propose", f"import {IN}/log.csv --out json --json",
               f"import {IN}/log.csv {IN}/german.csv --out several", "info mapped german"),
    "characterise": (f"characterise {IN}/sines --model {M}/sample.json --model {IN}/damper.yaml --out page",
                     f"characterise {IN}/sines --model topic:/measured_force --json", f"characterise {NEW}"),
    "learn-stroke": (f"learn-stroke {IN}/stroke.yaml --out learned",
                     "learn-stroke ../inputs/stroke.yaml --out learned --json",
                     "rig learned/learned.yaml --out again"),
    "identify": (
        f"identify {NEW} --validate {IN}/new_2 --terms 6 {SEARCH} --blend speed:-0.3,0.3 "
        "--weight zero_crossing=3 --out blended.json --report blended.html",
        f"identify {NEW} --folds 2 --terms 4 {SEARCH} --rate 500 --json --out folds.json",
        f"identify {NEW} --method thesis --terms 4 --time 3600 --no-certificate --no-band {SEARCH} --out thesis.json",
        f"identify {NEW} --teacher {IN}/damper.yaml --terms 4 {SEARCH} --out taught.json",
    ),
    "structures": (
        f"identify {NEW} --structure sigmoid --units 2 {SEARCH} --rate 250 --out sigmoid.json --report sigmoid.html",
        f"identify {NEW} --structure anfis --rules 3x2 {SEARCH} --rate 250 --out anfis.json --report anfis.html",
        f"identify {NEW} --structure anfis --memberships 2x3 {SEARCH} --rate 250 --out grid.json",
    ),
    "hydraulic": (f"identify {NEW} --structure hydraulic --kind uniflow --curves 3 {SEARCH} --rate 250 "
                  "--out hydraulic.json --report hydraulic.html",),
    "auto": (f"identify {NEW} --structure auto {SEARCH} --rate 250 --out auto.json --report auto.html",),
    "campaign": (f"identify --campaign {IN}/campaign.yaml --out campaign --jobs 1",
                 f"identify --campaign {IN}/campaign.yaml --out campaign --jobs 1 --json",
                 f"compare campaign {IN}/worn_1", "compare campaign"),
    "iterate": (f"iterate {IN}/iterate.yaml --out loop", f"iterate {IN}/iterate.yaml --out loop --json"),
    "validate": (
        f"validate {M}/sample.json {IN}/bags/sine_4hz {NEW} --weight zero_crossing=3 --report sample.html",
        f"validate {IN}/poly.json {NEW} {IN}/new_2 --part 0.2:0.9 --json",
        *(f"validate {M}/{name}.json {NEW} --report {name}.html" for name in STRUCTURES),
        *(f"validate {M}/{name}.json --certificate" for name in (*STRUCTURES, "tight", "sample")),
    ),
    "compare": (f"compare {M}/sample.json {IN}/poly.json {IN}/damper.yaml {NEW} {IN}/new_2 --report compare.html",
                f"compare {M}/sample.json {M}/network.json {IN}/sines --json"),
    "replay": (f"replay {M}/sample.json {NEW} --out replayed", f"replay {M}/band.json {NEW} --out band --json",
               "simulate --sim topic:/observer/estimate replayed --out topic.csv"),
    "simulate": (*(f"simulate --sim {M}/{name}.json {NEW} --out {name}.csv" for name in STRUCTURES),
                 f"simulate --sim {IN}/damper.yaml {IN}/sines --out rig.csv",
                 f"simulate --sim {IN}/bouc_wen.yaml {IN}/sines --out bouc_wen.csv --json",
                 f"simulate --sim passive:force {NEW} --out passive.csv"),
    "export-data": (f"export-data {NEW} --out table.csv --model {IN}/poly.json",
                    f"export-data {IN}/sines --out logged.csv", "import logged.csv --out back"),
    "export": (*(f"export {M}/{name}.json --out {name}.c" for name in STRUCTURES),
               f"export {M}/sample.json --out sample.c --name rear --json",
               f"export {IN}/poly.json --out poly.fmu --sources-only",
               f"export {IN}/poly.json --ros-package rear_observer"),
    "fmu": (f"export {M}/sample.json --out sample.fmu", f"simulate --sim sample.fmu {NEW} --out fmu.csv"),  # needs cc
    "diagnose": (  # with references; the repair is used
        f"diagnose --sim {IN}/damper.yaml --real {IN}/worn_1 --held-out {IN}/worn_2 --reference {NEW} {IN}/new_2 "
        "--out gap --threads 1",
        f"simulate --sim gap/augmented.json {IN}/worn_2 --out repaired.csv",
        f"compare {IN}/damper.yaml gap/augmented.json {IN}/worn_2",
    ),
    "diagnose-model": (f"diagnose --sim {M}/sample.json --real {WORN} --out gap --threads 1 --json",
                       "rig gap/next_experiment.yaml --out next"),
    "diagnose-function": (f"diagnose --sim passive:force --real {WORN} --out gap --threads 1",),
    "fleet": (f"diagnose --sim {M}/sample.json --real {IN}/long {IN}/worn_1 --reference {NEW} --each recording "
              "--jobs 1 --out fleet",),
    "blind": (
        "blind make --out cases --seed 5 --cases 2 --seconds 5 --plants bouc_wen --kind effect none "
        "--effects current_scale --gap-to-noise 10 --jobs 1",
        "blind run cases --out results --simulation predictions --jobs 1",
        "blind score cases results --out score.md",
        "blind score cases results --json",
    ),
    "wrong": (
        "", "identfy", "identify", f"identify {NEW} --terms 0", f"identify {NEW} --units 3", "info missing",
        f"info {IN}/log.csv", f"info {NEW} --signals {IN}/typo.yaml", f"info {NEW} --signals {IN}/signals.yaml",
        f"rig {IN}/not_yaml.yaml --out x", f"rig {IN}/unknown_key.yaml --out x", "rig sine_5hz --out x",
        f"validate {IN}/broken.json {NEW}", f"validate {IN}/signals.yaml {NEW}", f"validate {M}/sample.json",
        f"import {IN}/unclear.csv --out x", f"import {IN}/broken.csv --out x", f"import {IN}/log.csv --out {NEW}",
        f"identify {NEW} --validate {NEW} --out x.json", f"identify {NEW} --out {IN}/poly.json",
        f"identify {NEW} --rate 5000 --out x.json", f"simulate --sim nothing:there {NEW} --out x.csv",
        f"compare {M}/sample.json", f"export {M}/sample.json --out sample.txt",
        f"replay {M}/sample.json {NEW} --out {NEW}",
        f"diagnose --real {NEW} --out x", "serve missing", "blind make --out x", "schema nothing", "completion csh",
        f"characterise {IN}/log.yaml", f"iterate {IN}/stroke.yaml", f"learn-stroke {IN}/iterate.yaml --out x",
        f"identify {NEW} --ros-args", f"validate {M}/sample.json {NEW} --part 0.9:0.1", "--version --quiet",
    ),
}  # fmt: skip

SERVED = ("campaign/campaign", "diagnose/gap", "fleet/fleet", "iterate/loop", "inputs/poly.json", "inputs/poly.html",
          "inputs/new_1", "inputs/new_2", "learn-stroke/learned", "identify/blended.json")  # fmt: skip
COMPARED = "model=poly.json&model=blended.json&bag=new_2"  # the query of `ces serve`'s pages that compare
