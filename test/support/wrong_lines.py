"""Wrong command lines, drawn from a program's own option table: each holds at least one thing that cannot be right."""

from __future__ import annotations

import argparse
import io
import re
from contextlib import redirect_stderr
from pathlib import Path

from hypothesis import reject
from hypothesis import strategies as st

from ces_observer.errors import CesError

GOOD_BAG, MODEL, NOTES = "good_bag", "model.json", "notes.txt"
UNUSABLE_BAGS = ("cut_bag", "bad_metadata", "empty_folder", "random.mcap", "random.db3", "missing", NOTES)
UNUSABLE_FILES = (NOTES, "binary.yaml", "tabs.yaml", "alias.yaml", "list.json", "cut.json", "empty.yaml", "nan.json")
ALPHABETS = (range(1, 128), range(128, 0xD800), range(0xE000, 0x110000))  # without surrogates
NUMBERS = ("nan", "inf", "-inf", "1e999", "-1", "0", "1e5.5", "0x10", "99999999999999999999", "1_0_", "½", "9" * 5000)
WORDS = ("1", "3", "10", "0.5", "0:1", "auto", "1,1,1", "2x2", "0.001")
PATHS = (f"{NOTES}/x", "n" * 300, f"{NOTES}/é/\u2028/x", f"{NOTES}/\udcff")  # the last is not UTF-8


def list_actions(parser):
    """Return the options and arguments of a parser that take a part in a command line."""
    return [
        action for action in parser._actions if not isinstance(action, argparse._HelpAction | argparse._VersionAction)
    ]


def is_path(action):
    """Return whether an action takes paths or free text, of which a path below a file is neither."""
    return action.nargs != 0 and action.choices is None and action.type in (None, str, Path)


def word_for(action):
    """Return a plausible word for an action."""
    if action.choices is not None:
        return str(next(iter(action.choices)))
    if action.metavar == "BAG" and action.dest != "out":
        return GOOD_BAG
    if "MODEL" in str(action.metavar) and action.dest != "out":
        return MODEL
    if action.type in (None, str, Path):
        return _new_name(action) if action.dest in ("out", "report") else NOTES
    return next(word for word in WORDS if accepts(action, word))


def _new_name(action):
    """Return a name for an output, with the first suffix that the option's help names."""
    suffix = re.search(r"(?<=[A-Z])\.[a-z]+|(?<= \()\.[a-z]+", f"{action.metavar} {action.help}")
    return f"new_output{suffix.group() if suffix else ''}"


def accepts(action, word):
    """Return whether the action's type takes a word."""
    try:
        action.type(word)
    except (argparse.ArgumentTypeError, ValueError, TypeError):
        return False
    return True


def written(action, word):
    """Return the words that give an action a word."""
    if not action.option_strings:
        return [word]
    return [f"{action.option_strings[-1]}={word}"] if action.nargs is None else [action.option_strings[-1], word]


@st.composite
def wrong_lines(draw, parser):
    """Draw a command line for `parser` that has to be refused."""
    return _make_line(draw(st.randoms(use_true_random=True)), parser)


def _make_line(dice, parser):
    actions = list_actions(parser)
    kinds = [kind for kind in KINDS if kind[0](actions)]
    kinds += 2 * [kind for kind in kinds if kind[1] in DEEP]  # those that pass the parser
    if getattr(parser, "rules", ()) and dice.randrange(10) == 0:
        return option_that_does_not_apply(dice, actions, parser)
    _, make = dice.choice(kinds)
    return make(dice, actions)


def make_text(dice, keep=lambda text: True):
    """Return a text of any characters that `keep` is true for."""
    while True:
        letters = (chr(dice.choice(dice.choice(ALPHABETS))) for _ in range(dice.randint(1, 12)))
        if keep(text := "".join(letters)):
            return text


def base(dice, actions, without=(), more=()):
    """Return plausible words for all arguments, --out and required options, and for some others, in drawn order."""
    usual = [a for a in actions if a.required or not a.option_strings or a.dest == "out"]
    some = [a for a in actions if a.nargs != 0 and a not in usual]
    extra = dice.sample(some, min(len(some), dice.randrange(3)))
    chosen = [a for a in [*usual, *extra] if a not in without]
    options = [written(a, word_for(a)) for a in chosen if a.option_strings]
    options = [*options, *more]
    dice.shuffle(options)
    positionals = [word_for(a) for a in chosen if not a.option_strings]
    return [*positionals, *(word for words in options for word in words)]


def _with(dice, actions, action, word):
    if action.option_strings:
        return base(dice, actions, [action], [written(action, word)])
    words = base(dice, actions, [action])
    return [word.lstrip("-") or "x", *words] if dice.random() < 0.5 else [*words, "--", word]


def _choose(dice, actions, keep):
    return dice.choice([action for action in actions if keep(action)])


def _typed(action):
    return callable(action.type) and not is_path(action) and action.choices is None and bool(action.option_strings)


def wrong_type(dice, actions):
    action = _choose(dice, actions, _typed)
    wrong = [number for number in NUMBERS if not accepts(action, number)]
    word = dice.choice([*wrong, make_text(dice, lambda text: not accepts(action, text))])
    return _with(dice, actions, action, word)


def wrong_choice(dice, actions):
    action = _choose(dice, actions, lambda a: a.choices and a.option_strings)
    return _with(dice, actions, action, make_text(dice, lambda text: text not in map(str, action.choices)))


def flag_with_value(dice, actions):
    action = _choose(dice, actions, lambda a: a.nargs == 0)
    return [*base(dice, actions, [action]), f"{action.option_strings[-1]}={make_text(dice)}"]


def unknown_option(dice, actions):
    known = [text for action in actions for text in action.option_strings] + ["--help", "--version"]
    name = "--help"
    while any(option.startswith(name) for option in known):
        name = f"--{''.join(dice.choices('abcdefghijklmnopqrstuvwxyzäß', k=dice.randint(1, 9)))}x"
    return [*base(dice, actions), *dice.choice([[name], [f"{name}=1"], [name, "1"]])]


def missing_required(dice, actions):
    action = _choose(dice, actions, lambda a: a.required)
    return base(dice, actions, [action])


def missing_value(dice, actions):
    action = _choose(dice, actions, lambda a: a.option_strings and a.nargs in (None, "+"))
    return [*base(dice, actions, [action]), action.option_strings[-1]]


def empty_value(dice, actions):
    action = _choose(dice, actions, lambda a: a.nargs != 0)
    return _with(dice, actions, action, "") if action.option_strings else [*base(dice, actions, [action]), ""]


def path_below_a_file(dice, actions):
    path = dice.choice([*PATHS, *(f"{NOTES}/{make_text(dice)}" for _ in PATHS)])
    return _with(dice, actions, _choose(dice, actions, is_path), path)


def file_of_another_kind(dice, actions):
    return _with(dice, actions, _choose(dice, actions, is_path), NOTES)


def folder_for_a_file(dice, actions):
    return _with(dice, actions, _choose(dice, actions, _names_file), dice.choice(["empty_folder", GOOD_BAG]))


def option_that_does_not_apply(dice, actions, parser):
    """Draw an option that the table of rules forbids beside the others."""
    action = _choose(dice, actions, lambda a: a.option_strings)
    more = [action.option_strings[-1]] if action.nargs == 0 else written(action, word_for(action))
    words = base(dice, actions, [action], [more])
    with redirect_stderr(io.StringIO()):
        try:
            parser.parse_args(words)
        except CesError:
            return words
        except SystemExit:
            reject()
    return reject()


def unusable_bag(dice, actions):
    return _with(dice, actions, _choose(dice, actions, _reads_bags), dice.choice(UNUSABLE_BAGS))


def unusable_file(dice, actions):
    action = _choose(dice, actions, _reads_file)
    return _with(dice, actions, action, dice.choice(UNUSABLE_FILES))


def _reads_bags(action):
    return action.metavar == "BAG" and action.dest != "out"


def _names_file(action):
    named = action.type is Path and str(action.metavar).startswith("FILE") and action.nargs is None
    return named and "folder" not in str(action.help)


def _reads_file(action):
    named = str(action.metavar)
    return action.dest != "out" and (named in ("PLAN", "SIM", "MODEL.json") or named.endswith(".yaml"))


def _some(keep):
    return lambda actions: any(keep(action) for action in actions)


KINDS = (
    (_some(_typed), wrong_type),
    (_some(lambda a: a.choices and a.option_strings), wrong_choice),
    (_some(lambda a: a.nargs == 0), flag_with_value),
    (lambda actions: True, unknown_option),
    (_some(lambda a: a.required), missing_required),
    (_some(lambda a: a.option_strings and a.nargs in (None, "+")), missing_value),
    (_some(lambda a: a.nargs != 0), empty_value),
    (_some(is_path), path_below_a_file),
    (_some(is_path), file_of_another_kind),
    (_some(_names_file), folder_for_a_file),
    (_some(_reads_bags), unusable_bag),
    (_some(_reads_file), unusable_file),
)
DEEP = (path_below_a_file, file_of_another_kind, folder_for_a_file, unusable_bag, unusable_file)
