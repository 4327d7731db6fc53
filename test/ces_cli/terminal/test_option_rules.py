"""Options that do not apply are errors, from tables beside the options of each program."""

from __future__ import annotations

import pytest

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
        OptionRule("size", lambda values: values["shape"] == "square", "applies to --shape square, not to {shape}"),
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
