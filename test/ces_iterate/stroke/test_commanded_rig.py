"""Strokes learned on the rigs of `ces iterate`: an operator behind a folder, whose log has no command."""

from pathlib import Path

import numpy as np
import pytest

from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_iterate.commands import INTERVAL_S, read_commands
from ces_iterate.errors import IterateError, StrokeError
from ces_iterate.plan import RigLimits
from ces_iterate.rigs.folder import FolderRig
from ces_iterate.stroke.learning import LearningSettings, ProbeSettings, StrokeGoal, learn_stroke
from ces_iterate.stroke.limits import StrokeLimits
from ces_iterate.stroke.rigs import CommandedRig, VirtualStrokeRig
from ces_rig.experiment import parse_experiment

LIMITS = RigLimits(0.05, 1.5, 200.0, 0.2, 1.6)
TIME = np.arange(2501) * INTERVAL_S


def experiment(**current):
    current = current or {"kind": "constant", "current_A": 0.5}
    stroke = {"kind": "noise", "peak_to_peak_m": 0.03, "cutoff_Hz": 8.0}
    slow = {"bandwidth_Hz": 18.0, "compliance_m_N": 4e-7}
    return parse_experiment({"duration_s": 2.5, "stroke": stroke, "current": current, "actuator": slow}, "e.yaml")


class BagOperator:
    """Runs each experiment on the virtual rig and drops its bag, whose clock starts somewhere else every time."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.rig, self.count = folder, VirtualStrokeRig(experiment()), 0

    def sleep(self, seconds: float) -> None:
        for run in sorted(self.folder.glob("run_*")):
            if not any((run / "log").iterdir()):
                commands = read_commands(run / "commands.csv")
                recording = self.rig.run(commands.stroke_m, commands.seed + int(run.name[-2:]))
                channels = {name: recording.channel(name) for name in ("position", "current", "force")}
                write_bag(run / "log" / "bag", recording_topics(Recording("bag", channels), load_signals(None)))
                self.count += 1


@pytest.mark.slow
def test_a_stroke_is_learned_on_a_dyno_behind_a_folder(tmp_path):
    operator = BagOperator(tmp_path)
    folder_rig = FolderRig(None, load_signals(None), 0.01, note=lambda text: None, sleep=operator.sleep)
    rig = CommandedRig(folder_rig, experiment(), LIMITS, tmp_path)
    wanted = experiment().stroke.samples(TIME, np.random.default_rng(0))
    goal = StrokeGoal(wanted, INTERVAL_S, StrokeLimits(), LearningSettings(3), ProbeSettings(3.0, 40.0))
    learned = learn_stroke(rig, goal)
    assert operator.count == len(learned.runs) + 1
    assert learned.first.error_m > 10 * learned.repeatability_m  # shape and compliance; the mean delay is aligned away
    assert learned.confirmation.error_m < 1.5 * learned.repeatability_m
    assert learn_stroke(rig, goal).confirmation.error_m == learned.confirmation.error_m  # from the logs that are there
    assert operator.count == len(learned.runs) + 1
    with pytest.raises(StrokeError, match="run_00: has the log of another command; choose another --out"):
        rig.run(wanted, 0)


def test_the_current_is_that_of_the_experiment(tmp_path):
    seen = []

    class CommandListener:
        def run(self, commands, folder):
            seen.append(commands)
            return Recording("r", {})

    CommandedRig(CommandListener(), experiment(kind="steps", levels_A=[0.3, 0.6], hold_s=0.5), LIMITS, tmp_path).run(
        0.01 * np.sin(TIME), 4
    )
    assert seen[0].current_A[[0, 600, 1100]] == pytest.approx([0.3, 0.6, 0.3])
    assert seen[0].seed == 4 and (tmp_path / "run_04" / "commands.csv").exists()


def test_commands_beyond_the_limits_never_reach_the_rig(tmp_path):
    with pytest.raises(IterateError, match=r"stroke 0\.06 m exceeds 0\.05 m"):
        CommandedRig(None, experiment(), LIMITS, tmp_path).run(np.linspace(0.0, 0.06, 2501), 0)


def test_a_current_that_needs_the_force_is_refused(tmp_path):
    with pytest.raises(StrokeError, match="reg1 answers a measured force; choose another kind of current"):
        CommandedRig(None, experiment(kind="reg1"), LIMITS, tmp_path)
