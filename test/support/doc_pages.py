"""The documents as a reader uses them: their blocks of code, and a folder in which the commands in them run.

A page is run from top to bottom in a folder of its own with the files of `make_standard_files`:

* ```console: every line `$ ces ...` runs; the lines below it occur in what it prints, whatever their numbers. It must
  end well, unless the first of these lines is its error (`ces identify: error: ...`).
* ```python: runs, in one namespace for the page; a block that needs ROS 2 is only compiled.
* ```sh: words alone are checked: programs, options, nodes, launch files, parameters, targets of make.
* any block whose first line is a comment with a file's name (`# new.yaml`) is written to that file.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from small_recordings import RULES, UNITS, make_columns, write_small_csv

from bench.reference.programs import parser_of
from ces_cli.identify.request import PARAMETERS
from ces_cli.main import PROGRAMS, main
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.reading import read_recording
from ces_data.recording import Channel, Recording
from ces_observer.nodes import parameter_table
from ces_observer.signals import FIELDS, NAMES, Signals
from ces_rig.live.rig import OF_THE_NODE as OF_THE_RIG_NODE
from ces_rig.live.rig import OF_THE_RIG

ROOT = Path(__file__).resolve().parents[2]
SHORTER = {  # what makes a command quick
    "identify": "--time 3 --starts 1 --threads 1 --no-band",
    "diagnose": "--threads 1",  # and fits the effects of QUICK_EFFECTS alone
}
SMALL = "--structure polynomial --terms 3 --candidates rules.yaml"  # instead of auto, which takes 50 s, or the default
QUICK_EFFECTS = (("friction", "coulomb_stribeck"), ("valve_lag", "first_order"))
PARSED_ONLY = {  # these commands are not run, nor those that read what they would write
    "serve": "has no end",
    "iterate": "10 s for one iteration; test/ces_rig/loop runs it",
    "blind": "tens of diagnoses; test/ces_cli/blind runs it",
    "--each": "a diagnosis for each vehicle; test/ces_gap/test_fleet.py runs it",
    "--identify": "a search of every structure; test/ces_gap/baseline runs it",
}
SLOW = re.compile(
    r"^rig characterise|^diagnose .*--sim \S+\.yaml"
)  # 5 and 10 s; test/ces_rig and test/ces_gap run these
QUICK = ("--template", "--list", "--show-candidates", "--help")  # such commands run all the same
OUTPUTS = ("--out", "--report")
NEEDS_ROS = re.compile(r"^\s*(from|import) (launch|launch_ros|rclpy|ros2launch)\b|\bNode\(package=", re.MULTILINE)
SIMULATOR = """\
import numpy as np


def force(time_s, position_m, current_A, *, seal_N=5.0, knee_m_s=0.12):
    speed = np.gradient(position_m, time_s)
    opened = np.sign(speed) * np.abs(speed) ** 0.5 * (400.0 + 1500.0 * current_A) + 100.0 * speed
    return opened + seal_N * np.tanh(speed / knee_m_s)
"""
CAMPAIGN = """\
bags: {all: [recordings/a, recordings/b]}
validate: {fresh: [fresh]}
structures:
  polynomial: {terms: [2, 3], candidates: rules.yaml}
limits: {time: 1}
"""
PLAN = """\
limits: {stroke_m: 0.02, speed_m_s: 0.7, acceleration_m_s2: 60.0, low_A: 0.3, high_A: 1.0, frequency_Hz: 12.0}
rig: {kind: virtual}
experiments: {duration_s: 3.0}
stop: {budget_s: 3.0}
"""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    line: int
    language: str
    text: str


def read_blocks(page: str) -> list[Block]:
    """Return the fenced blocks of a page, also those inside lists."""
    found = re.finditer(r"^( *)```([\w-]*)[^\n]*\n(.*?)^\1```", page, re.MULTILINE | re.DOTALL)
    return [
        Block(page.count("\n", 0, match.start()) + 1, match[2], re.sub(f"^{match[1]}", "", match[3], flags=re.M))
        for match in found
    ]


def read_commands(text: str, prompt: str = "") -> list[tuple[str, list[str]]]:
    """Return the command lines in a block, continued lines joined, each with the lines printed below it."""
    found: list[tuple[str, list[str]]] = []
    for line in re.sub(r"\\\n\s*", "", text).splitlines():
        if line.startswith(prompt):
            found.append((line.removeprefix(prompt), []))
        else:
            assert found, f"'{line}' comes before a command; a command begins with '{prompt}'"
            found[-1][1].append(line)
    return found


def make_parser(program: str) -> argparse.ArgumentParser:
    """Return the parser of a program."""
    assert program in PROGRAMS, f"there is no program '{program}'"
    return parser_of(program)


def parse(command: str) -> list[str]:
    """Return the words after `ces` of a command that its program accepts; fails otherwise."""
    text = re.split(r"\s[|>]\s|\s+#\s", command)[0]
    program, *words = shlex.split(text)[1:]
    if program == "help" or program.startswith("-"):
        return [program, *words]
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(errors):
            make_parser(program).parse_args(words)
    except SystemExit as stop:
        assert not stop.code, f"{command}: {errors.getvalue().strip().splitlines()[-1]}"
    return [program, *words]


def write_recording(path: Path, seed: int, seconds: float = 4.0, friction_N: float = 0.0) -> None:
    """Write a bag of the damper of `small_recordings`, with a worn seal's friction added."""
    t, columns = make_columns(seconds, seed)
    speed = np.gradient(columns["position"], t)
    columns["force"] = columns["force"] + friction_N * np.tanh(speed / 0.02)
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    channels = {name: Channel(name, UNITS[name], stamps, values) for name, values in columns.items()}
    path.parent.mkdir(exist_ok=True)
    write_bag(path, recording_topics(Recording(path.name, channels), Signals.from_mapping({}, "defaults")))


def cut_recording(path: Path, bag: Path, first_s: float = 8.0, last_s: float = 13.0) -> None:
    """Write a part of a bag."""
    recording = read_recording(bag)
    start = min(channel.stamps_ns[0] for channel in recording.channels.values())
    ends = (start + np.array([first_s, last_s]) * 1e9).astype(np.int64)
    parts = {name: slice(*np.searchsorted(c.stamps_ns, ends)) for name, c in recording.channels.items()}
    cut = {
        name: replace(channel, stamps_ns=channel.stamps_ns[parts[name]], values=channel.values[parts[name]])
        for name, channel in recording.channels.items()
    }
    path.parent.mkdir(exist_ok=True)
    write_bag(path, recording_topics(replace(recording, channels=cut), Signals.from_mapping({}, "defaults")))


def make_standard_files(folder: Path) -> None:
    """Write the files that commands of a page may name, besides the project's `config` and `examples`."""
    for bag in sorted((ROOT / "bags").glob("*/")):
        cut_recording(folder / "bags" / bag.name, bag)
    for seed, name in enumerate(("recordings/a", "recordings/b", "recordings/c", "fresh"), start=1):
        write_recording(folder / name, seed)
    for seed, name in enumerate(("new/a", "new/b"), start=5):
        write_recording(folder / name, seed, 6.0)
    for seed, name in enumerate(("worn/a", "worn/b"), start=7):
        write_recording(folder / name, seed, 6.0, friction_N=60.0)
    for name, seed in (("my_log.csv", 1), ("my_other_log.csv", 2)):
        write_small_csv(folder / name, seed, seconds=4.0, in_mm=True)
    for seed in (1, 2):
        text = write_small_csv(folder / f"sweep_{seed}.csv", seed, seconds=4.0, in_mm=True).read_text()
        header = "t_s,x_mm,current_A,F_N"  # the columns of config/import/utfsm_mr.yaml
        (folder / f"sweep_{seed}.csv").write_text(text.replace(text.partition("\n")[0], header))
    for name in ("signals.yaml", "vehicle.yaml"):
        shutil.copy(ROOT / "config/signals.yaml", folder / name)
    for name in ("other.json", "best.json"):
        shutil.copy(ROOT / "config/models/sample.json", folder / name)
    texts = {"simulator.py": SIMULATOR, "campaign.yaml": CAMPAIGN, "plan.yaml": PLAN, "damper.yaml": "kind: bouc_wen\n"}
    for name, text in {**texts, "rules.yaml": RULES}.items():
        (folder / name).write_text(text)
    runner = PageRunner(folder)
    for command in (
        "ces identify recordings/a recordings/b --terms 3 --candidates rules.yaml --out model.json",
        "ces diagnose --sim simulator:force --real worn/a --held-out worn/b --out gap",
    ):
        runner.run_command(command, [])


@dataclass
class PageRunner:
    """Runs the blocks of a page in `folder`, which holds the standard files."""

    folder: Path
    standard: set[Path] = field(default_factory=set)
    not_made: list[str] = field(default_factory=list)
    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "__main__"})

    def run(self, page: str) -> None:
        """Run a page's blocks; fails with the line of the block in which something is wrong."""
        self.standard = {path.relative_to(self.folder) for path in self.folder.glob("*")}
        with in_folder(self.folder):
            for block in read_blocks(page):
                try:
                    self.run_block(block)
                except (Exception, SystemExit) as error:
                    raise AssertionError(f"line {block.line}: {type(error).__name__}: {error}") from error

    def run_block(self, block: Block) -> None:
        """Write the file that a block shows, then run or check the block."""
        if name := re.match(r"# ([\w./-]+\.\w+)\n", block.text):
            Path(name[1]).write_text(block.text)
        if block.language == "console":
            for command, printed in read_commands(block.text, "$ "):
                self.run_command(command, printed)
        elif block.language == "python":
            code = compile(block.text, "<page>", "exec")
            if not NEEDS_ROS.search(block.text):
                with contextlib.redirect_stdout(io.StringIO()):
                    exec(code, self.names)
        elif block.language in ("sh", "bash"):
            for command, _ in read_commands(block.text):
                check_words(command)
        else:
            loose = re.search(r"^(\$ |ces [a-z]|ros2 |make [a-z]).*", block.text, re.MULTILINE)
            assert block.language or not loose, f"'{loose and loose[0]}' is in a block that is neither console nor sh"

    def run_command(self, command: str, printed: list[str]) -> None:
        """Run a command of a shell; fails unless it ends with 0 and prints these lines, whatever their numbers."""
        if loop := re.fullmatch(r"for (\w+) in (.*?); do (.*?);? done", command):
            for value in loop[2].split():
                self.run_command(re.sub(rf"\$\{{?{loop[1]}\b\}}?", value, loop[3]), [])
            return
        assert command.startswith("ces "), f"'{command}': a console block runs ces alone; use sh"
        words = parse(command)
        if self.must_not_run(words):
            self.not_made += [name for name in list_outputs(words) if Path(name) not in self.standard]
            return
        command, _, file = re.split(r"\s\|\s|\s+#\s", command)[0].partition(" > ")
        words = expand(shlex.split(os.path.expandvars(command))[1:])
        for name in {Path(name) for name in list_outputs(words)} & self.standard:
            self.standard.discard(name)
            shutil.rmtree(name) if name.is_dir() else name.unlink()
        status, output, text = run_words(words + list_shorter(words))
        fails = bool(printed) and printed[0].startswith(f"ces {words[0]}: error: ")
        assert status == (2 if fails else 0), f"'{command}' ended with status {status}:\n{text}"
        if file:
            target = Path(file.strip()).expanduser()
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(output)
        elif words[0] != "diagnose" or fails:  # of few effects, a diagnosis says other things
            require_lines(printed, text, command)

    def must_not_run(self, words: list[str]) -> bool:
        """Whether a command takes too long, reads what such a command writes, or needs a program that is missing."""
        if set(words) & set(PARSED_ONLY) and not set(words) & set(QUICK):
            return True
        if SLOW.search(" ".join(words)):
            return True
        if any(word == name or word.startswith((f"{name}/", f"{name}:")) for word in words for name in self.not_made):
            return True
        return any(word.endswith(".fmu") for word in words) and shutil.which("cc") is None


def list_outputs(words: list[str]) -> list[str]:
    """Return the files and folders that a command writes."""
    return [value for word, value in pairwise(words) if word in OUTPUTS]


def list_shorter(words: list[str]) -> list[str]:
    """Return the options that make a command quick."""
    if words[0] not in SHORTER or set(words) & {*QUICK, "--campaign"}:
        return []
    if "--method" in words and "--candidates" not in words:
        return shlex.split(f"{SHORTER[words[0]]} --terms 3 --candidates rules.yaml")
    plain = not {"--structure", "--candidates", "--method", "--blend"} & set(words)
    small = shlex.split(SMALL) if words[0] == "identify" and (plain or "auto" in words) else []
    return shlex.split(SHORTER[words[0]]) + small


def expand(words: list[str]) -> list[str]:
    """Return the words with wildcards and the home folder put in, as a shell does."""
    words = [str(Path(word).expanduser()) if word.startswith("~") else word for word in words]
    return [name for word in words for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]


def run_words(words: list[str]) -> tuple[int, str, str]:
    """Run `ces`; return its exit status, its standard output, and that with its messages behind."""
    output, messages = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["ces", *words]
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(messages):
            status = main(words)
    except SystemExit as stop:
        status = int(stop.code or 0)
    finally:
        sys.argv = before
    return status, output.getvalue(), output.getvalue() + messages.getvalue()


def require_lines(wanted: list[str], text: str, command: str) -> None:
    """Fail unless each line occurs in the text, with other numbers and spaces or not."""
    printed = plain_line(text)
    for line in wanted:
        if line.strip() not in ("", "...", "…"):
            assert plain_line(line) in printed, f"'{command}' does not print '{line}', but:\n{text}"


def plain_line(text: str) -> str:
    """Return a text with # for each number and one space for each run of spaces and rules."""
    return re.sub(r"[\s─]+", " ", re.sub(r"[-−+<]?\d[\d.,]*(e[-+]?\d+)?", "#", text)).strip()


@contextlib.contextmanager
def in_folder(folder: Path) -> Iterator[None]:
    """Work in a folder, with its modules and a home in it; modules imported from it are forgotten at the end."""
    known, paths, home, before = set(sys.modules), list(sys.path), os.environ.get("HOME", ""), Path.cwd()
    os.chdir(folder)
    os.environ.update(HOME=str(folder / "home"), PWD=str(folder))
    (folder / "home").mkdir(exist_ok=True)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        os.chdir(before)
        os.environ.update(HOME=home, PWD=str(before))
        sys.path[:] = paths
        for name in set(sys.modules) - known:
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(folder)):
                del sys.modules[name]


def check_words(command: str) -> None:
    """Fail if a command of a shell names a program, option, launch file, parameter or target that does not exist."""
    for text in re.split(r"\s(?:&&|\|\|?|;)\s|;\s", re.sub(r"(^|\s)#\s.*", "", command)):
        part = re.sub(r"^\s*(\w+=\S+ )*", "", text)
        if part.startswith("ces "):
            parse(re.sub(r"\$\{?\w+\}?", "1", part))
        elif part.startswith("ros2 run ces_observer "):
            check_node(part.split(maxsplit=3)[3])
        elif part.startswith("ros2 launch ces_observer "):
            check_launch(part.split()[3:])
        elif part.startswith("ros2 param "):
            (name,) = part.split()[4:5] or [""]
            assert not name or name in node_parameters(), f"no node has the parameter '{name}'"
        elif part.startswith("make "):
            targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
            for target in (word for word in part.split()[1:] if "=" not in word):
                assert target in targets, f"the Makefile has no target '{target}'"
        elif script := re.match(r"(?:\S*/)?python3? (-m )?(bench\S+)", part):
            path = script[2].replace(".", "/") if script[1] else script[2]
            there = [ROOT / path, ROOT / f"{path}.py", ROOT / path / "__main__.py"]
            assert any(one.is_file() for one in there), f"'{part}': there is no {script[2]}"


def check_node(text: str) -> None:
    """Check `NAME [--ros-args ...]` after `ros2 run ces_observer`."""
    name, *words = text.split()
    if "--ros-args" not in words:
        assert name in ("observer", "controller") or parse(f"ces {text}")
        return
    assert name in ("observer", "controller", "rig", "identify"), f"there is no node '{name}'"
    for option, value in pairwise(words):
        if option == "-p":
            assert value.partition(":=")[0] in node_parameters(), f"no node has the parameter '{value}'"


def check_launch(words: list[str]) -> None:
    """Check `FILE.launch.py NAME:=VALUE...`."""
    file = ROOT / "launch" / words[0]
    assert file.is_file(), f"there is no launch file '{words[0]}'"
    names = re.findall(r'(?:^    |LaunchArgument\()"(\w+)"', file.read_text(encoding="utf-8"), re.MULTILINE)
    for word in words[1:]:
        assert word.partition(":=")[0] in names, f"{words[0]} has no argument '{word}'"


@cache
def node_parameters() -> frozenset[str]:
    """Return the parameters of all nodes, those of a signal as `position.topic`."""
    tables = (parameter_table.OF_THE_NODE, parameter_table.OF_A_DAMPER, parameter_table.OF_THE_CONTROLLER)
    options = (*chain(*tables), parameter_table.NAME, *PARAMETERS, *OF_THE_RIG_NODE, *OF_THE_RIG)
    signals = (f"{name}.{key}" for name in NAMES for key in FIELDS)
    return frozenset((*(option.name for option in options), *signals, "dampers", "use_sim_time"))
