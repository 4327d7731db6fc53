"""Every configuration file of a user comes in by one way: the same mistakes are refused, in the same words."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from ces_data.config_file import MAX_BYTES, read_yaml_mapping
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.signals_file import load_signals
from ces_identify.campaign.plan import load_campaign
from ces_identify.polynomial.rules_file import load_rules
from ces_observer.errors import CesError
from ces_rig.dampers.hydraulic.parameters import load_damper
from ces_rig.experiments.virtual import load_description, load_experiment, load_rig

READERS = (
    *(load_campaign, load_rules, load_dyno_mapping, load_damper, load_experiment, load_description, load_rig),
    *(ANY_KEY := (load_signals, lambda path: read_yaml_mapping(path, "a mapping"))),
)
BOMB = b"a: &a [x, x]\n" + b"".join(b"%c: &%c [*%c, *%c]\n" % (c, c, c - 1, c - 1) for c in range(98, 122))
MISTAKES = (
    (b"- 1\n", ": is not a mapping; expected "),
    (b"", ": is not a mapping; expected "),
    (b"a: [", ":1: not valid YAML: "),
    (b"a: \xff\n", ": is not UTF-8 text; expected "),
    (b"#" * (MAX_BYTES + 1), f": larger than {MAX_BYTES} bytes; expected "),
    (BOMB, ":2: alias '*a'; write the value out"),
    (b"a: " + b"[" * 30 + b"]" * 30, ":1: nested more than 20 deep; remove some levels"),
    (b"force: 1\nforce: 2\n", ":2: 'force' is given twice; keep one"),
    (b"? [1, 2]\n: 3\n", ":1: a key is a list or a mapping; expected a name"),
    (b"force: !!python/object/apply:os.system [ls]\n", ":1: not valid YAML: "),
)
UNKNOWN_KEY = (b"frequenzy: 1\n", ": unknown key 'frequenzy'; known are ")


@pytest.mark.parametrize("read", READERS)
def test_a_mistake_is_the_same_line_whatever_the_file(tmp_path: Path, read: Callable[[Path], object]) -> None:
    path = tmp_path / "x.yaml"
    for content, expected in MISTAKES if read in ANY_KEY else (*MISTAKES, UNKNOWN_KEY):
        path.write_bytes(content)
        with pytest.raises(CesError) as caught:
            read(path)
        assert str(caught.value).startswith(f"{path}{expected}")
        assert "\n" not in str(caught.value)
    with pytest.raises(CesError, match=r"none\.yaml: cannot be read: No such file or directory; expected "):
        read(tmp_path / "none.yaml")
