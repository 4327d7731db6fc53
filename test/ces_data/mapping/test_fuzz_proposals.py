"""Tables of any content: a proposal either reads, or ends in one clear line."""

from __future__ import annotations

import json

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ces_data.logs.log_import import to_recording
from ces_data.mapping.proposals import propose_mapping
from ces_observer.errors import CesError

CELLS = st.one_of(
    st.sampled_from(
        ["", "0", "1", "2", "-1.5", "1e400", "nan", "inf", "1,5", "2024-05-01 12:00:00", "12:00:01.5", "ok"]
    ),
    st.integers(-3, 10**20).map(str),
)
NAMES = st.sampled_from(
    ["t", "time_s", "x_mm", "x", "x", "force_N", "F", "current_A", "stamp_ns", "[mm]", "", "0", "é"]
)
TABLES = st.integers(1, 5).flatmap(
    lambda width: st.lists(st.lists(CELLS, min_size=width, max_size=width), min_size=1, max_size=8)
)
NUMBERS = st.one_of(st.integers(-(10**30), 10**30), st.floats(), st.none(), st.booleans(), st.text(max_size=3))
TREES = st.recursive(
    NUMBERS,
    lambda inner: st.one_of(st.lists(inner, max_size=5), st.dictionaries(st.sampled_from(["t", "x", "F", "a"]), inner)),
    max_leaves=20,
)
settings.register_profile("proposals", deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
FEW = settings(settings.get_profile("proposals"), max_examples=40, derandomize=True)


def propose(path):
    """Propose a mapping and use it; a CesError has to be one line."""
    try:
        proposal = propose_mapping(path)
        if proposal.mapping is not None:
            to_recording(proposal.log, proposal.mapping)
    except CesError as error:
        assert "\n" not in str(error)


@FEW
@given(names=st.lists(NAMES, max_size=5), rows=TABLES, mark=st.sampled_from([",", ";", "\t", "|", " "]))
def test_text_tables(tmp_path, names, rows, mark):
    path = tmp_path / "log.csv"
    path.write_text("\n".join(mark.join(row) for row in [names, *rows]), encoding="utf-8")
    propose(path)


@FEW
@given(tree=TREES)
def test_json_trees(tmp_path, tree):
    path = tmp_path / "log.json"
    path.write_text(json.dumps(tree))
    propose(path)
