"""The controller's shipped parameter file and sample model say what the code takes for granted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from ces_observer.control.force_controller import Tuning
from ces_observer.model import load_model
from ces_observer.nodes.parameter_table import OF_THE_CONTROLLER, TUNING

CONFIG = Path(__file__).resolve().parents[3] / "config"
NOT_IN_THE_FILE = {"model"}


def shipped() -> dict[str, Any]:
    given = yaml.safe_load((CONFIG / "controller.yaml").read_text(encoding="utf-8"))["/**"]["ros__parameters"]
    curve = {f"curve.{key}": points for key, points in given.pop("curve").items()}
    return {**given, **curve}


def test_the_file_shows_every_parameter_at_its_default() -> None:
    given = shipped()
    assert given.pop("use_sim_time") is False
    defaults = {spec.name: spec.default for spec in OF_THE_CONTROLLER}
    assert given == {name: value for name, value in defaults.items() if name not in NOT_IN_THE_FILE}


def test_the_tuning_has_the_tables_defaults() -> None:
    table = {spec.name: spec.default for spec in TUNING}
    made = Tuning(low_A=0.0, high_A=1.0, safe_A=0.5)
    for name in ("rate_A_s", "loop_gain_1_s", "settle_m", "preview_s", "lead_filter_s", "recovery_s"):
        assert getattr(made, name) == table[name]
    assert made.max_gap_s == table["timeout_s"]


def test_the_sample_model_is_proved_stable_and_tells_where_it_is_from() -> None:
    model = load_model(CONFIG / "models" / "sample.json")
    assert model.is_stable()
    assert [one["recording"] for one in model.provenance["identification"]] == ["noise", "sweep", "road"]
