import pytest
import yaml

from ces_cli.identify.program import candidate_rules, make_parser
from ces_identify.polynomial.candidates import built_in_rules, load_rules
from ces_observer.errors import CesError


def rules(*arguments):
    return candidate_rules(make_parser().parse_args(arguments))


def test_the_built_in_rules_are_the_default():
    assert rules() == load_rules(None)


def test_constructed_inputs_and_blends_add_up_and_may_build_on_each_other(tmp_path):
    path = tmp_path / "rules.yaml"
    own = {"slip": {"kind": "stop", "of": "position", "half_width": 0.001}}
    built_in = yaml.safe_load(built_in_rules())
    path.write_text(yaml.safe_dump({**built_in, "constructed": {**built_in["constructed"], **own}}))
    result = rules(
        *("--candidates", str(path), "--construct", "remanence:0.05", "--construct", "frequency"),
        *("--construct", "lag:0.02,auto", "--blend", "frequency:2,6", "--blend", "current:0.3,0.5,0.7"),
        *("--blend", "lag_2:0.3,0.7", "--blend", "slip:0,0.001"),
    )
    assert {name: len(made) for name, made in result.constructed.items()} == {
        **{"valve": 1, "slip": 1, "remanence_1": 1, "frequency": 1, "lag_1": 1, "lag_2": 1},
        **{"by_frequency": 2, "by_valve": 3, "by_lag_2": 2, "by_slip": 2},
    }
    assert result.open_lags == ("valve", "lag_2")
    assert result.signals["by_frequency"].lags == result.signals["by_valve"].lags == (0,)


@pytest.mark.parametrize("option", [("--construct", "frequency"), ("--blend", "speed:0,1")])
@pytest.mark.parametrize("structure", ["sigmoid", "anfis"])
def test_other_structures_accept_no_candidates(structure, option):
    with pytest.raises(CesError, match=f"applies to --structure polynomial or auto, not to {structure}"):
        rules("--structure", structure, *option)
