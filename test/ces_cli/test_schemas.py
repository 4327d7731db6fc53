"""The JSON Schemas: shipped files, templates and examples follow them, parameter files with a typo do not."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft7Validator

from ces_cli.main import main
from ces_cli.schema import BUILDERS, build_schema
from ces_cli.terminal.outputs import make_schemas
from ces_data.logs.log_mapping import TEMPLATE as IMPORT_TEMPLATE
from ces_identify.polynomial.rules_file import built_in_rules
from ces_identify.schema_files import ABOUT, KEYWORD, path_of_schema, schema_line
from ces_rig.loop.rigs import TEMPLATE as ITERATE_TEMPLATE

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted(
    path for folder in ("config", "ces_rig", "ces_identify", "ces_data") for path in (ROOT / folder).rglob("*.yaml")
)


class Loader(yaml.SafeLoader):
    """Reads 1e6 as a number and yes as a text, as YAML 1.2 and the editors' language servers do."""


Loader.yaml_implicit_resolvers = {
    first: [rule for rule in rules if rule[0] not in ("tag:yaml.org,2002:bool", "tag:yaml.org,2002:float")]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile("^(true|false)$"), ["t", "f"])
NUMBER = re.compile(r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$")
Loader.add_implicit_resolver("tag:yaml.org,2002:float", NUMBER, list("-+.0123456789"))


@cache
def schema_of(name: str) -> dict[str, Any]:
    return dict(json.loads(build_schema(name)))


def faults(name: str, text: str) -> list[str]:
    return [error.message for error in Draft7Validator(schema_of(name)).iter_errors(yaml.load(text, Loader))]


def schema_named_in(path: Path) -> Path:
    """Return the file that the first line of a shipped file names, relative to the folder of that file."""
    first = path.read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith(KEYWORD), f"{path}: {first}"
    return (path.parent / first.removeprefix(KEYWORD)).resolve()


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.mark.parametrize("name", BUILDERS)
def test_every_schema_is_one_and_is_described(name: str) -> None:
    Draft7Validator.check_schema(schema_of(name))
    assert set(ABOUT) == set(BUILDERS)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: str(path.relative_to(ROOT)))
def test_shipped_files_name_their_schema_and_follow_it(path: Path) -> None:
    schema = schema_named_in(path)
    assert schema.parent == ROOT / "ces_identify" / "schemas"  # as in the folder share/ of an installation
    assert faults(schema.stem, path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["import", "--template"], "import"),
        (["iterate", "--template"], "iterate"),
        (["identify", "--show-candidates"], "candidates"),
    ],
)
def test_templates_name_the_installed_schema_and_follow_it(
    words: list[str], name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(schema_line(name)) and Path(printed.splitlines()[0].removeprefix(KEYWORD)).is_file()
    assert faults(name, printed) == []


def test_every_commented_setting_of_the_templates_is_known() -> None:
    for name, text in (("import", IMPORT_TEMPLATE), ("iterate", ITERATE_TEMPLATE)):
        schema = build_schema(name)
        for line in text.splitlines():
            found = re.match(r"\s*# ?([a-z_A-Z]+): \S", line)
            assert found is None or f'"{found[1]}"' in schema or found[1] in ("For", "Time"), line


def test_the_built_in_rules_follow_their_schema() -> None:
    assert faults("candidates", built_in_rules()) == faults("candidates", built_in_rules("thesis")) == []


def documented() -> Iterator[tuple[str, str]]:
    """Yield the YAML examples of the documentation, each with the name of its page."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        for block in re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            if "--qos-profile-overrides-path" not in block and "controller_manager" not in block:  # files of ROS 2
                yield page.name, block


def test_examples_in_the_documentation_follow_a_schema() -> None:
    examples = [(page, text) for page, text in documented() if isinstance(yaml.load(text, Loader), dict)]
    assert len(examples) > 3
    for page, text in examples:
        found = {name: [f for f in faults(name, text) if "required property" not in f] for name in BUILDERS}
        assert [] in found.values(), f"{page}:\n{text}"


def changed(text: str, path: tuple[str, ...], value: object) -> str:
    """Return a YAML text with the value at a path of keys replaced, or removed if `value` is `...`."""
    content = yaml.load(text, Loader)
    place: Any = content
    for key in path[:-1]:
        place = place[key]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return yaml.safe_dump(content)


NODE_FILES = {"observer": "observer", "controller": "controller", "rig-node": "rig_live", "identify-node": "identify"}


@pytest.mark.parametrize("name", NODE_FILES)
def test_parameter_files_with_a_typo_or_a_wrong_type_are_refused(name: str) -> None:
    text = (ROOT / "config" / f"{NODE_FILES[name]}.yaml").read_text(encoding="utf-8")
    parameters = yaml.load(text, Loader)["/**"]["ros__parameters"]
    for key, value in parameters.items():
        assert faults(name, changed(text, ("/**", "ros__parameters", f"{key}_x"), value)), key
        wrong: object = 1 if isinstance(value, str | dict) else "wrong"
        assert faults(name, changed(text, ("/**", "ros__parameters", key), wrong)), key
    assert faults(name, text.replace("/**", "/front/node")) == []


def test_several_dampers_and_dotted_names_follow_the_schema() -> None:
    own = {"model": "m.json", "max_age_s": 0.1, "position": {"field": "position[fork]"}, "current.topic": "front"}
    parameters = {"dampers": ["front"], "front": own, "position.scale": 0.001}
    text = yaml.safe_dump({"/ns": {"observer": {"ros__parameters": parameters}}})
    assert faults("observer", text) == []
    assert faults("observer", text.replace("max_age_s", "max_age"))
    assert faults("signals", yaml.safe_dump({"dampers": ["a"], "a": {"position": {"topic": "x"}}})) == []
    assert faults("signals", yaml.safe_dump({"/**": {"ros__parameters": {"positon": {"topic": "x"}}}}))


def test_ces_schema_prints_writes_and_lists(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", "signals"]) == 0
    assert capsys.readouterr().out == build_schema("signals")
    assert main(["schema", "signals", "--path"]) == 0
    assert Path(capsys.readouterr().out.strip()).is_file()
    assert main(["schema", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(ABOUT)
    assert main(["schema", "--all", str(tmp_path / "all")]) == 0
    assert {path.stem for path in (tmp_path / "all").iterdir()} == set(BUILDERS)


def test_schemas_of_another_version_are_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ces_identify.schema_files.files", lambda package: tmp_path)  # nothing was built
    old = path_of_schema("signals")
    old.parent.mkdir(parents=True)
    old.write_text("{}")
    make_schemas()
    assert old.read_text(encoding="utf-8") == build_schema("signals")
