"""Plans: the template is a plan, defaults are its values, and every mistake is one line that names the key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from iterate_examples import make_plan, sine_commands

from ces_observer.errors import CesError
from ces_rig.errors import RigError
from ces_rig.experiments.commands import HeatLimits
from ces_rig.loop.rigs import TEMPLATE, parse_plan


def template() -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load(TEMPLATE)
    return content


def test_the_template_shows_the_defaults() -> None:
    content = template()
    shown = parse_plan(content, "t", Path())
    bare = parse_plan({"limits": content["limits"], "rig": content["rig"]}, "t", Path())
    assert shown.stop == bare.stop
    assert shown.identify == bare.identify
    assert shown.experiments == bare.experiments
    assert shown.limits.heat == HeatLimits()


@pytest.mark.parametrize(
    ("section", "values", "part"),
    [
        ("limits", None, "limits is None; expected a mapping.*template shows it"),
        ("rig", None, "rig is None; expected a mapping.*template shows it"),
        ("limits", {"stroke_m": 0.02}, "'speed_m_s' is missing"),
        ("stop", {"budget": 1}, "unknown key 'budget'"),
        ("stop", {"budget_s": "much"}, "budget_s is 'much'"),
        ("experiments", {"kind": "guessed"}, "one of designed, repeated"),
        ("experiments", {"commands": "mine.csv"}, "needs kind: repeated"),
        ("identify", {"structure": "oracle"}, "one of polynomial"),
        ("identify", {"delay": 0.03}, "delay is 0.03; expected a number from 0 to 0.02 s"),
        ("seed", -1, "seed is -1"),
        ("recordings", "bag", "expected a list of texts"),
        ("typo", {}, "unknown key 'typo'"),
    ],
)
def test_a_mistake_is_one_line_with_the_key(section: str, values: Any, part: str) -> None:
    content = template() | {section: values}
    with pytest.raises(CesError, match=part) as error:
        parse_plan(content, "plan.yaml", Path())
    assert "\n" not in str(error.value)
    assert str(error.value).startswith("plan.yaml")


def test_currents_in_the_wrong_order_are_refused() -> None:
    limits = template()["limits"] | {"low_A": 1.0, "high_A": 0.5}
    with pytest.raises(RigError, match=r"plan.yaml: limits: .*exchange them"):
        parse_plan(template() | {"limits": limits}, "plan.yaml", Path())


def test_limits_find_every_excess(tmp_path: Path) -> None:
    limits = make_plan(tmp_path).limits
    assert list(limits.excess(sine_commands())) == []
    loud = sine_commands()
    loud = type(loud)("loud", 8.0 * loud.stroke_m, 3.0 * loud.current_A)
    found = " ".join(limits.excess(loud))
    assert all(word in found for word in ("stroke", "speed", "acceleration", "current"))
    with pytest.raises(RigError, match="loud: stroke"):
        limits.require_within(loud)


def test_a_load_follows_the_power_and_falls_while_the_damper_rests() -> None:
    import numpy as np

    heat = HeatLimits(power_W=100.0, memory_s=10.0)
    load = heat.load_after(0.0, np.full(20_000, 80.0), 1e-3)
    assert load[-1] == pytest.approx(80.0 * (1.0 - np.exp(-2.0)), rel=1e-3)
    rest = heat.cool_down_s(float(load[-1]), 20.0)
    assert heat.load_after(float(load[-1]), np.zeros(round(rest * 1e3)), 1e-3)[-1] == pytest.approx(20.0, rel=1e-2)
    assert heat.cool_down_s(10.0, 20.0) == 0.0


def test_the_delay_of_a_plan_reaches_the_identification() -> None:
    plan = parse_plan(template() | {"identify": {"delay": 0.003}}, "plan.yaml", Path())
    assert plan.identify.request(1).delay == 0.003
    assert parse_plan(template(), "plan.yaml", Path()).identify.request(1).delay == 0.0
