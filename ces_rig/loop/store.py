"""The folder of an iteration: every experiment, recording and model is kept; a killed run goes on where it was.

Each step ends with one rename, and what exists is not done again:

    iteration_03/commands.csv    the experiment, with design.json
    iteration_03/recording/      what the rig recorded (rosbag2)
    iteration_03/model.json      identified from all recordings up to this one, with ensemble_1.json ...
    iterations.jsonl             one line for each finished iteration
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from pathlib import Path
from typing import Any

from ces_data.bags.reader import RecordingWarning, read_recording
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_observer.errors import OptionName
from ces_observer.fields import REQUIRED, Field
from ces_observer.json_text import quote, write_atomically
from ces_observer.model import Model, load_model
from ces_observer.records import declare, part, read_record, write_record
from ces_observer.shapes import ByName
from ces_rig.errors import RigError
from ces_rig.experiments.commands import NEED, RigCommands, read_commands, write_commands
from ces_rig.experiments.information import LeastKnownRegion
from ces_rig.loop.rigs import Plan, load_plan

ROWS = "iterations.jsonl"
RECORDING = "recording"
INPUTS = "inputs.json"
SAME = ("rig", "seed", "recordings", "experiments")  # of a plan that goes on
MODEL, REPORT, PLAN = "model.json", "report.html", "plan.yaml"


def _read_cost(value: object) -> float:
    """Return a cost, NaN for the null of a run that diverged."""
    if value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
        return nan if value is None else float(value)
    raise ValueError(f"{quote(value)}; expected a number or null")


COST = Field(kind=object, make=_read_cost, text=lambda cost: cost if isfinite(cost) else None)
FRESH = Field(default=None, kind=float, null=None, text=COST.text)


@dataclass(frozen=True)
class Iteration:
    """A finished iteration, as its line in `iterations.jsonl`.

    `fresh_J` is the cost [%] of the previous model on this recording, None for the first, and `fresh_high_J` the upper
    end of its 95 % interval, None if the recording is too short for one; `fit_J` that of the new model
    on all recordings together, `validation_J` those on the plan's validation recordings. `coverage` is the share of the
    states within the limits that the recordings show; `disagreement` and `band` are relative errors to expect there
    (RMS), and `regions` what is least known.
    """

    number: int
    name: str
    recorded_s: float
    total_s: float
    rest_s: float
    load_W: float
    fresh_J: float | None = declare(replace(FRESH, default=REQUIRED))
    fit_J: float = declare(COST)
    validation_J: Mapping[str, float] = part(kind=ByName(COST))
    coverage: float = part()
    disagreement: float = declare(COST)
    band: float = declare(COST)
    regions: tuple[LeastKnownRegion, ...] = part()
    model: str = part()
    fresh_high_J: float | None = declare(FRESH)

    def to_row(self) -> dict[str, Any]:
        """Return the line's content."""
        return {"key": str(self.number), **write_record(self)}

    @staticmethod
    def from_row(row: dict[str, Any], where: Path) -> Iteration:
        """Return the iteration of a line; raises RigError if it is not one."""
        content = {key: value for key, value in row.items() if key != "key"}
        try:
            return read_record(Iteration, content, str(where), RigError)
        except RigError as error:
            raise RigError(
                f"{error}: the line is from another version; start with another ", OptionName("out")
            ) from None


@dataclass(frozen=True)
class Step:
    """The files of one iteration."""

    folder: Path
    number: int

    @staticmethod
    def open(root: Path, number: int) -> Step:
        """Return the step, its folder made if needed; raises RigError if that fails."""
        folder = root / f"iteration_{number:02d}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RigError(f"{folder}: cannot be made: {error.strerror}; choose another ", OptionName("out")) from None
        return Step(folder, number)

    def read_commands(self) -> RigCommands | None:
        """Return the experiment, None if it is not designed yet."""
        path = self.folder / "commands.csv"
        if not path.exists():
            return None
        facts = json.loads((self.folder / "design.json").read_text(encoding="utf-8"))
        return read_commands(path).repeat(facts["name"], facts["seed"], facts["rest_s"])

    def write_commands(self, commands: RigCommands) -> None:
        """Keep an experiment."""
        facts = {"name": commands.name, "seed": commands.seed, "rest_s": commands.rest_s}
        write_atomically(self.folder / "design.json", json.dumps(facts, indent=1) + "\n")
        write_commands(self.folder / "commands.csv", commands)

    def read_recording(self, name: str) -> Recording:
        """Return the recording under the experiment's name; raises CesError if it is damaged."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)  # of log times: this bag was written with exact ones
            return replace(read_recording(self.folder / RECORDING, load_signals(), NEED), name=name)

    def write_models(self, model: Model, ensemble: Sequence[Model]) -> None:
        """Keep a model and its ensemble; the model last, so that with it the ensemble is complete."""
        for old in self.folder.glob("ensemble_*.json"):
            old.unlink()
        for k, member in enumerate(ensemble, 1):
            member.save(self.folder / f"ensemble_{k}.json")
        model.save(self.folder / MODEL)

    def read_models(self) -> tuple[Model, list[Model]]:
        """Return the model and its ensemble."""
        ensemble = [load_model(path) for path in sorted(self.folder.glob("ensemble_*.json"))]
        return load_model(self.folder / MODEL), ensemble


def keep_plan(root: Path, plan: Plan, text: str) -> None:
    """Keep the plan's text beside the results; raises RigError if these began with another rig, seed or purpose."""
    kept = root / PLAN
    if kept.exists():
        before = load_plan(kept)
        for key in SAME:
            if getattr(before, key) != getattr(plan, key):
                raise RigError(f"{root}: began with another '{key}' ({PLAN} there); choose another ", OptionName("out"))
    write_atomically(kept, text)


def keep_inputs(root: Path, plan: Plan, given: Sequence[Recording]) -> None:
    """Keep a hash of each input; raises RigError naming one that has changed since the iteration began."""
    digests = {text: recording.sha256 for text, recording in zip(plan.recordings, given, strict=True)}
    for text in (plan.experiments.commands, *plan.rig.values()):
        if isinstance(text, str) and text and (file := plan.path(text)).is_file():
            digests[text] = hashlib.sha256(file.read_bytes()).hexdigest()
    kept = root / INPUTS
    before = json.loads(kept.read_text(encoding="utf-8")) if kept.is_file() else {}
    for text, digest in digests.items():
        if before.get(text, digest) != digest:
            raise RigError(
                f"{plan.path(text)}: has changed since {root} began with it; choose another ", OptionName("out")
            )
    write_atomically(kept, json.dumps(digests, indent=1) + "\n")
