"""Options that do not apply are errors, from tables beside the options of each program."""

from __future__ import annotations

import pytest

from ces_cli.main import main
from ces_cli.terminal.options import ALL, OptionRule, never_with, only_with
from ces_cli.terminal.terminal import Parser
from ces_observer.errors import CesError


def make_parser():
    parser = Parser(prog="ces try")
    parser.add_argument("bags", nargs="*", default=[], metavar="BAG")
    parser.add_argument("--size", type=int, default=7)
    parser.add_argument("--shape", choices=("round", "square"), default="round")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--many", action="append", default=[])
    parser.rules = (
        only_with("many", "bags", "applies to bags; name one"),
        never_with(ALL, "list", "does not apply with --list", but="list shape"),
        OptionRule("size", lambda options: options.shape == "square", "applies to --shape square, not to {shape}"),
    )
    return parser


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--many", "x"], "--many applies to bags; name one"),
        (["one", "--list"], "BAG does not apply with --list"),
        (["--list", "--size=7"], "--size does not apply with --list"),
        (["--size", "7"], "--size applies to --shape square, not to round"),  # the default, but it was given
        (["--si=7"], "--size applies to --shape square, not to round"),  # shortened
    ],
)
def test_options_that_break_a_rule(words, message):
    parser = make_parser()
    for parser.intermixed in (False, True):
        with pytest.raises(CesError, match=f"^{message}$"):
            parser.parse_args(words)


@pytest.mark.parametrize(
    "words", [[], ["--list", "--shape", "square"], ["--shape=square", "--size=9"], ["--", "--size"]]
)
def test_options_that_keep_the_rules(words):
    assert make_parser().parse_args(words).list == ("--list" in words)


@pytest.mark.parametrize(
    ("words", "name"), [([""], "the first argument"), (["--shape="], "--shape"), (["--shape", ""], "--shape")]
)
def test_an_empty_value_is_named(capsys, words, name):
    with pytest.raises(SystemExit):
        make_parser().parse_args(words)
    assert f"ces try: error: {name}: a value is empty" in capsys.readouterr().err


def test_an_error_is_one_line_whatever_was_written(capsys):
    with pytest.raises(SystemExit):
        make_parser().parse_args(["--shape=a\nb\u2028\udcff"])
    assert len(capsys.readouterr().err.splitlines()) == 1


SIGMOID, POLYNOMIAL = ("--structure", "sigmoid"), ()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        *(
            (
                ("identify", "bag", *SIGMOID, *option),
                f"{option[0]} applies to --structure polynomial or auto, not to sigmoid",
            )
            for option in (
                *(("--terms", "9"), ("--terms", "25"), ("--method", "both"), ("--candidates", "rules.yaml")),
                *(("--construct", "frequency"), ("--blend", "speed:0,1")),
            )
        ),
        *(
            (
                ("identify", "bag", option, value),
                f"{option} applies to --structure {structure} or auto, not to polynomial",
            )
            for structure, option, value in (
                *(("sigmoid", "--units", "9"), ("sigmoid", "--lags", "2,2,2"), ("anfis", "--rules", "5x2")),
                *(("anfis", "--memberships", "3x3"), ("relaxation", "--springs", "2"), ("chambers", "--curves", "3")),
            )
        ),
        (("identify", "bag", "--dask", "here:1"), "--dask applies to campaigns; add --campaign FILE.yaml"),
        (("import", "log.csv", "--propose", "--json"), "--json does not apply with --propose, which prints a mapping"),
        (("identify", "bag", "--jobs", "2"), "--jobs applies to campaigns"),
        (("identify", "bag", "--campaign", "c.yaml"), "BAG has no effect with --campaign; set it in c.yaml instead"),
        (("identify", "--campaign", "c.yaml", "--seed", "1"), "--seed has no effect with --campaign"),
        (("identify", "--campaign", "c.yaml", "--dask", "a:1", "--jobs", "1"), "--jobs applies to this machine"),
        (("identify", "--show-candidates", "bag"), "BAG does not apply with --show-candidates"),
        (("validate", "m.json", "--certificate", "--report", "r.html"), "--report applies to recordings; name them"),
        (
            ("diagnose", "--real", "a", "--out", "o", "--sim", "m.json", "--structure", "auto"),
            "--structure applies to --id",
        ),
        (
            ("diagnose", "--real", "a", "--out", "o", "--sim", "m.json", "--identify"),
            "--sim does not apply with --identify",
        ),
        (("diagnose", "--real", "a", "--out", "o", "--sim", "m.json", "--jobs", "2"), "--jobs applies to fleets"),
        (
            ("diagnose", "--real", "a", "--out", "o", "--sim", "m", "--each", "vehicle", "--held-out", "b"),
            "--held-out has no effect with --each",
        ),
        (
            ("diagnose", "--real", "a", "--out", "o", "--sim", "m", "--each", "vehicle", "--overwrite"),
            "--overwrite has no",
        ),
        (("export", "m.json", "--out", "m.c", "--signals", "s.yaml"), "--signals applies to --ros-package only"),
        (("export", "m.json", "--out", "m.c", "--sources-only"), "--sources-only applies to an FMU only"),
        (("export", "m.json", "--ros-package", "p", "--format", "c"), "--format does not apply to --ros-package"),
        (("rig", "--list", "--seed", "1"), "--seed does not apply with --list"),
        (("import", "--template", "--out", "o"), "--out does not apply with --template"),
        (("iterate", "--template", "plan.yaml"), "PLAN does not apply with --template"),
        (
            ("blind", "make", "--seed", "1", "--out", "o", "--grid", "small", "--gap-to-noise", "3"),
            "--gap-to-noise does not",
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_options_of_programs_that_do_not_apply(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"ces {words[0]}: error: {message}")
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
