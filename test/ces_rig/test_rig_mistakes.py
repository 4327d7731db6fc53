"""Mistakes in descriptions of the rig: each costs one line that names the place and what was expected."""

import numpy as np
import pytest

from ces_data.waveforms.strokes import make_stroke
from ces_observer.errors import CesError
from ces_rig.dampers.hydraulic.parameters import parse_damper
from ces_rig.experiments.virtual import DamperDescription, make_current, parse_experiment, run
from ces_rig.live.rig import with_effects

STROKE = {"kind": "sine", "amplitude_m": 0.01, "frequency_Hz": 4.0}
GOOD = {"duration_s": 1.0, "stroke": STROKE, "current": {"kind": "constant", "current_A": 0.5}}
TIME = np.arange(0.0, 10.0, 1e-3)
REST = {"kind": "rest", "duration_s": 1.0}

READ = {
    "damper": lambda given: parse_damper(given, "x.yaml"),
    "stroke": lambda given: make_stroke(given, "x.yaml: stroke"),
    "current": lambda given: make_current(given, "x.yaml: current"),
    "parts": lambda given: make_stroke({"kind": "sequence", "parts": given}, "x.yaml: stroke"),
    "actuator": lambda given: run(parse_experiment({**GOOD, "actuator": given}, "x.yaml")),
    "experiment": lambda given: run(parse_experiment({**GOOD, **given}, "x.yaml")),
    "effect": lambda given: with_effects(DamperDescription(), [given]),
}
MISTAKES = {
    "damper": [
        ({"seal": {"coulomb": 3}}, "seal: unknown key 'coulomb'; did you mean 'coulomb_N'"),
        ({"reservoir": {"gas_m3": -1e-5}}, r"reservoir: gas_m3 is -1e-05; expected a number from 1e-06 to 0.01 m³"),
        ({"oil": {"density_kg_m3": "thick"}}, "oil: density_kg_m3 is 'thick'; expected a number from 500"),
        ({"oil": {"air_fraction": float("nan")}}, "air_fraction is nan"),
        ({"body": 3}, "body is 3; expected a mapping"),
        ({"body": {"rod_m": 0.05}}, "rod_m 0.05 is not smaller than bore_m 0.036"),
        ({"reservoir": {"gas_m3": 1e-5}}, "cannot take up the rod's volume"),
        ({"ces_valve": {"current_high_A": 0.2}}, "current_high_A is not above"),
        ({"ces_valve": {"current_high_A": 2.0}}, "allowed range 0.2 to 1.6 A does not contain the working range 0.29"),
        ({"ces_valve": {"cracking_high_Pa": 1e5}}, "cracking_high_Pa is below"),
        ({"seal": {"static_N": 5.0}}, "static_N 5 is below coulomb_N 28"),
        ({"piston": {"compression": {"full_open_Pa": 2e4}}}, "piston: compression: full_open_Pa 20000 is not above"),
    ],
    "stroke": [
        ({"kind": "sinus"}, "kind is 'sinus'; expected one of rest, sine"),
        ({}, "key 'kind' is missing"),
        ("sine", "stroke is 'sine'; expected a mapping with kind"),
        ({"kind": "sine", "amplitude_m": 0.01}, "'frequency_Hz' is missing; expected a number above 0 to 100 Hz"),
        ({"kind": "sine", "amplitude_m": 0, "frequency_Hz": 4}, "amplitude_m is 0; expected a number above 0"),
        ({"kind": "sine", "amplitude_m": 0.01, "frequency_Hz": 4, "phase": 1}, "unknown key 'phase'"),
        ({"kind": "road", "road_class": "E"}, "road_class is 'E'; expected one of A, B, C, D"),
        ({"kind": "noise", "order": 2.5}, "order is 2.5; expected a whole number"),
        ({"kind": "sum_of_sines", "amplitudes_m": [0.01], "frequencies_Hz": [1, 2]}, "expected equal lengths"),
        ({"kind": "sum_of_sines", "amplitudes_m": 0.01, "frequencies_Hz": [1]}, "expected a list of numbers"),
    ],
    "current": [
        ({"kind": "reg2"}, "kind is 'reg2'; expected one of constant"),
        ({"kind": "constant"}, "'current_A' is missing"),
        ({"kind": "constant", "current_A": -0.1}, "current_A is -0.1; expected a number from 0 to 10 A"),
        ({"kind": "binary", "low_A": 0.7, "high_A": 0.3}, "high_A is not above low_A"),
        ({"kind": "binary", "mean_s": 0.01}, "mean_s 0.01 is not above shortest_s"),
        ({"kind": "steps", "levels_A": []}, "expected a list of numbers"),
        (
            {"kind": "reg1", "speeds_m_s": [-0.1, 0.0, 0.1], "forces_N": [-10.0, 0.0, -5.0]},
            r"curve: -5 N at 0\.1 m/s would drive the motion",
        ),
        (
            {"kind": "sequence", "parts": [{"kind": "reg1", "duration_s": 1.0}]},
            "parts\\[0\\]: kind is 'reg1'; expected one of constant",
        ),
    ],
    "parts": [
        ([], "expected a list of 1 to 1000 mappings"),
        ([3], "parts\\[0\\] is 3; expected a mapping with kind"),
        ([{"kind": "rest"}], "parts\\[0\\]: key 'duration_s' is missing"),
        (
            [REST, {"kind": "sequence", "parts": [REST], "duration_s": 1.0}],
            "parts.*: kind is 'sequence'; expected one of rest",
        ),
        ([{"kind": "wave", "duration_s": 1.0}], "parts\\[0\\]: kind is 'wave'"),
    ],
    "actuator": [
        ({"bandwidth": 3.0}, "x.yaml: actuator: unknown key 'bandwidth'; did you mean 'bandwidth_Hz'"),
        ({"delay_s": -1.0}, "x.yaml: actuator: delay_s is -1.0; expected a number from 0 to 0.2 s"),
        ({"stroke_m": 0.08}, r"actuator: stroke_m is 0\.08; the damper's ends are at ±0\.06 m"),
    ],
    "experiment": [
        ({"duration_s": -1}, "x.yaml: duration_s is -1; expected a number from 0.1 to 7200 s"),
        ({"seed": 1.5}, "seed is 1.5; expected a whole number"),
        ({"tare": 3}, "tare is 3; expected true or false"),
        ({"current": None}, "x.yaml: current is None; expected a mapping with kind"),
        ({"damper": {"seal": {"x": 1}}}, "x.yaml: damper: seal: unknown key 'x'"),
        ({"sensors": {"force": {"rate_Hz": 0}}}, "x.yaml: sensors: force: rate_Hz is 0"),
        ({"sensors": {"speed": {}}}, "x.yaml: sensors: unknown key 'speed'"),
        ({"sensors": {"current_source": "guessed"}}, "expected one of measured, commanded"),
    ],
    "effect": [
        ("frction", "no effect 'frction' on a live hydraulic damper; expected one of friction,"),
        ("cell_resonance", "no effect 'cell_resonance'"),
        ("foaming", "no effect 'foaming'"),
        ("friction: {coulomb: 3}", "unknown key 'coulomb'; did you mean 'coulomb_N'"),
        ("friction: {severity: -1}", "severity -1.0; expected a number of at least 0"),
        ("friction: {severity: high}", "expected a name, or for example"),
        ("[", "expected a name, or for example"),
        ("inertia: {severity: 1000}", "moving_mass_kg is"),
    ],
}


@pytest.mark.parametrize(("what", "given", "says"), [(what, *row) for what, rows in MISTAKES.items() for row in rows])
def test_a_mistake_is_one_line(what, given, says):
    with pytest.raises(CesError, match=says) as caught:
        READ[what](given)
    text = str(caught.value)
    assert "\n" not in text and (what == "effect" or text.startswith("x.yaml: ") or "ends are at" in text), text
