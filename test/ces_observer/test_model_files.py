"""Model files of every structure: what is written is read back, and no number that cannot be is read."""

import json
import math
from collections.abc import Iterator

import pytest
from bands import BAND
from damper_models import plain_damper
from hydraulic_models import GROOVE, hydraulic_model, make_hydraulic
from mixture_models import mixture_model
from model_examples import make_model
from physical_models import LINEAR
from recurrent_models import make_recurrent, recurrent_model
from trained_models import experts_model, fuzzy_model, network_model

from ces_observer.errors import ModelError
from ces_observer.model import load_model, parse_model
from ces_observer.structures.constructed_inputs import Frequency, Hysteresis, Lag, make_memberships
from ces_observer.structures.terms import Factor, Term

CONSTRUCTED = (
    Hysteresis("hysteresis", "stop", "position", 0.002),
    Lag("valve", "current", 0.008),
    Frequency("frequency", 0.25, (0.5, 20.0), 1e-4),
    *make_memberships("by_current", "current", (0.2, 0.5, 1.1)),
)
TERMS = tuple(Term(1.0, (Factor(made.name, 0, 1.0, False, made),)) for made in CONSTRUCTED)
MODELS = {  # with the size that each tells
    "polynomial": (make_model(), "3 terms"),
    "a band": (make_model(band=BAND), "3 terms"),
    "a measured speed": (plain_damper(motion="speed", motion_noise=2e-3), "3 terms"),
    "constructed inputs": (
        make_model(terms=tuple(Term(1.0, (Factor(made.name, 0, 1.0, False, made),)) for made in CONSTRUCTED)),
        "6 terms",
    ),
    "network": (network_model(), "2 sigmoid units on 5 regressors"),
    "fuzzy": (fuzzy_model(), "4 rules on 5 regressors"),
    "experts": (experts_model(), "3 experts on 3 inputs"),
    "recurrent": (recurrent_model(), "2 networks with 12 filters, "),
    "recurrent, no current": (recurrent_model(make_recurrent(current=False)), "2 networks with 10 filters, "),
    "mixture": (mixture_model(), "mean of 3 models: 0.30 polynomial (3 terms), 0.45 recurrent ("),
    "uniflow": (hydraulic_model(LINEAR), "uniflow, 2 curves of the external valve"),
    "twin tube": (
        hydraulic_model(make_hydraulic(LINEAR.valve, bypass=GROOVE)),
        "twin tube, 3 curves of the piston valve, bypass",
    ),
}
NO_NUMBERS = (math.nan, math.inf, -1e300, 1e300, True, "1")


@pytest.mark.parametrize("name", MODELS)
def test_a_saved_model_reads_back_equal(name, tmp_path):
    model, size = MODELS[name]
    model.save(tmp_path / "m.json")
    again = load_model(tmp_path / "m.json")
    assert again == model and again.digest() == model.digest()
    assert again.size.startswith(size)


def numbers(node, key: str = "") -> Iterator[tuple[str, object, object]]:
    """Yield the key above each number in a file, and where it is; of a list the last one."""
    pairs = node.items() if isinstance(node, dict) else [(len(node) - 1, node[-1])] if node else []
    for place, value in pairs:
        name = place if isinstance(node, dict) else key
        if isinstance(value, dict | list):
            yield from numbers(value, name)
        elif isinstance(value, float):
            yield name, node, place


@pytest.mark.parametrize("name", MODELS)
def test_what_cannot_be_a_number_is_refused_by_its_key(name):
    raw = json.loads(MODELS[name][0].to_json())
    found = list(numbers({key: part for key, part in raw.items() if key not in ("provenance", "certificate")}))
    assert len(found) > 10
    for key, node, place in found:
        before = node[place]
        for value in NO_NUMBERS:
            node[place] = value
            with pytest.raises(ModelError, match=key) as caught:
                parse_model(json.dumps(raw), "m.json")
            assert str(caught.value).startswith("m.json") and "\n" not in str(caught.value)
        node[place] = before
