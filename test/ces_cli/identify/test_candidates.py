import pytest
import yaml

from ces_cli.identify.program import candidate_rules, make_parser
from ces_identify.polynomial.candidates import built_in_rules, load_rules
from ces_observer.errors import CesError


def rules(*arguments):
    return candidate_rules(make_parser().parse_args(arguments))


def test_the_built_in_rules_are_the_default():
    assert rules() == load_rules(None)


def test_blends_add_up_and_may_be_over_constructed_inputs(tmp_path):
    path = tmp_path / "rules.yaml"
    own = {"slip": {"kind": "stop", "of": "position", "half_width": 0.001}}
    built_in = yaml.safe_load(built_in_rules())
    path.write_text(yaml.safe_dump({**built_in, "constructed": {**built_in["constructed"], **own}}))
    result = rules("--candidates", str(path), "--blend", "current:0.3,0.5,0.7", "--blend", "slip:0,0.001")
    made = {name: len(made) for name, made in result.constructed.items()}
    assert made == {"valve": 1, "slip": 1, "by_valve": 3, "by_slip": 2}
    assert result.open_lags == ("valve",)
    assert result.signals["by_slip"].lags == result.signals["by_valve"].lags == (0,)


@pytest.mark.parametrize("structure", ["sigmoid", "anfis"])
def test_other_structures_accept_no_candidates(structure):
    with pytest.raises(CesError, match=f"applies to --structure polynomial or auto, not to {structure}"):
        rules("--structure", structure, "--blend", "speed:0,1")
