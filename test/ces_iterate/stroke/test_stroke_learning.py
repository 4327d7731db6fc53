"""Learning on the virtual rig: reaches the repeatability with an unknown and a wrong model, within the limits."""

import numpy as np
import pytest
from browser import find_faults, open_page

from ces_iterate.commands import INTERVAL_S
from ces_iterate.errors import StrokeError
from ces_iterate.stroke.actuator import ActuatorModel
from ces_iterate.stroke.learning import (
    CONVERGED,
    DIVERGED,
    FIRST,
    LEARNED,
    STALLED,
    LearningRun,
    LearningSettings,
    ProbeSettings,
    StrokeGoal,
    StrokeLearner,
    learn_stroke,
)
from ces_iterate.stroke.limits import StrokeLimits, measure_peaks
from ces_iterate.stroke.page import describe_kind, stroke_page
from ces_iterate.stroke.rigs import VirtualStrokeRig
from ces_rig.experiment import parse_experiment

SECONDS = 3.0
TIME = np.arange(round(SECONDS / INTERVAL_S) + 1) * INTERVAL_S
ACTUATOR = ActuatorModel(1.0, 0.004, 35.0, 0.8, 0.001)  # the virtual rig's default
SINE = {"kind": "sine", "amplitude_m": 0.01, "frequency_Hz": 4.0}

pytestmark = pytest.mark.slow


def rig_and_wanted(stroke=None, **actuator):
    stroke = stroke or {"kind": "noise", "cutoff_Hz": 8.0, "peak_to_peak_m": 0.03}
    current = {"kind": "constant", "current_A": 0.6}
    description = {"duration_s": SECONDS, "seed": 2, "stroke": stroke, "current": current, "actuator": actuator}
    experiment = parse_experiment(description, "e")
    return VirtualStrokeRig(experiment), experiment.stroke.samples(TIME, np.random.default_rng([2, 0]))


@pytest.fixture(scope="module")
def learned():
    rig, wanted = rig_and_wanted()
    return learn_stroke(rig, StrokeGoal(wanted, INTERVAL_S, StrokeLimits(), probe=ProbeSettings(5.0)))


def test_an_unknown_actuator_is_learned_to_its_repeatability(learned):
    assert learned.stopped in (CONVERGED, STALLED) and learned.iterations <= 8
    assert learned.confirmation.error_m < 0.1 * learned.first.error_m
    assert learned.confirmation.error_m < 1.5 * learned.repeatability_m
    assert learned.first.error_m > 1e-3
    assert learned.repeatability_m == pytest.approx((20e-6**2 + 11e-6**2) ** 0.5, rel=0.25)  # noise after the spline
    f = learned.learning_filter
    left = f.share * np.abs(1.0 - f.learning(f.frequency_Hz) * ACTUATOR.response(f.frequency_Hz))
    assert left.max() < 1.0 and f.contraction.max() < 1.0  # the condition holds for the actuator of the rig


def test_its_page_is_legible_on_screen_in_print_and_by_keys_and_reads_the_error_of_every_run(learned, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(stroke_page(learned, "Learned stroke e", {"command": "ces learn-stroke e.yaml --out learned"}))
    assert find_faults(path) == []
    with open_page(path) as page:
        frame = page.locator(".value-frame").first
        for number, run in enumerate(learned.runs):
            frame.locator(".value").nth(number).hover()
            read = frame.locator(".value-label").inner_text()
            assert read == f"run {number + 1}, {describe_kind(run)}: {1e6 * run.error_m:.0f} µm RMS"


def test_a_model_that_is_30_percent_wrong_is_enough():
    rig, wanted = rig_and_wanted()
    goal = StrokeGoal(wanted, INTERVAL_S, StrokeLimits(), model=ACTUATOR.scale(0.7, 0.7, 1.3))
    learned = learn_stroke(rig, goal)
    assert learned.probe is None and learned.iterations <= 8
    assert learned.confirmation.error_m < min(0.1 * learned.first.error_m, 1.5 * learned.repeatability_m)


def test_tight_limits_are_kept_by_every_command():
    rig, wanted = rig_and_wanted()
    peaks = measure_peaks(wanted, INTERVAL_S)
    tight = StrokeLimits(1.02 * peaks[0], 1.03 * peaks[1], 1.05 * peaks[2])
    learned = learn_stroke(rig, StrokeGoal(wanted, INTERVAL_S, tight, LearningSettings(3), ProbeSettings(4.0)))
    assert any(run.limited > 0.0 for run in learned.runs)
    for command in [run.command_m for run in learned.runs] + [learned.probe.command_m]:
        for peak, limit in zip(measure_peaks(command, INTERVAL_S), tight.as_tuple(), strict=True):
            assert peak <= limit * (1 + 1e-9)
    assert learned.confirmation.error_m < 0.3 * learned.first.error_m


def test_the_command_changes_by_at_most_a_step_per_run():
    rig, wanted = rig_and_wanted()
    goal = StrokeGoal(wanted, INTERVAL_S, StrokeLimits(), LearningSettings(2, step_m=1e-3), model=ACTUATOR)
    learned = learn_stroke(rig, goal)
    steps = [
        np.abs(b.command_m - a.command_m).max() for a, b in zip(learned.runs[1:], learned.runs[2:-1], strict=False)
    ]
    assert max(steps) == pytest.approx(1e-3, rel=1e-6)


def test_a_growing_error_goes_back_and_lowers_the_gain_until_it_stops():
    """A rig whose sign is wrong: every update makes it worse."""
    _, wanted = rig_and_wanted()
    goal = StrokeGoal(wanted, INTERVAL_S, StrokeLimits(), model=ACTUATOR)
    short = 0.95 * wanted
    learner = StrokeLearner(goal, None, [LearningRun(wanted, short + noise(n), 1e-3, FIRST) for n in range(2)])
    scales = []
    while not learner.stopped:
        command, _ = learner.next_command()
        scales.append(learner.scale)
        learner.add(LearningRun(command, wanted + noise(9), 2e-3, LEARNED))
        assert learner.best_index < 2
    assert learner.stopped == DIVERGED
    assert scales == [1.0, 0.5, 0.25, 0.125, 0.0625]


def test_noise_is_not_learned():
    """With nothing but noise in the error, the command hardly changes."""
    _, wanted = rig_and_wanted()
    settings = LearningSettings(stop_at=1.0)
    goal = StrokeGoal(wanted, INTERVAL_S, StrokeLimits(), settings, model=ACTUATOR)
    runs = [LearningRun(wanted, wanted + noise(n), 30e-6, FIRST) for n in range(2)]
    command, _ = StrokeLearner(goal, None, runs).next_command()
    assert 0.0 < np.std(command - wanted) < 0.25 * np.std(noise(0))


@pytest.mark.parametrize(
    ("stroke", "limits", "says"),
    [
        ({**SINE, "fade_s": 0.0}, StrokeLimits(), "at rest in one place"),
        ({"kind": "rest"}, StrokeLimits(), "does not move"),
        (SINE, StrokeLimits(0.009), "wanted stroke: its stroke reaches"),
    ],
)
def test_strokes_that_cannot_be_learned_are_refused_before_the_rig_moves(stroke, limits, says):
    rig, wanted = rig_and_wanted(stroke)
    with pytest.raises(StrokeError, match=says) as caught:
        learn_stroke(rig, StrokeGoal(wanted, INTERVAL_S, limits))
    assert "\n" not in str(caught.value)
    still = parse_experiment({"stroke": {"kind": "rest"}, "current": {"kind": "constant", "current_A": 0.5}}, "e")
    with pytest.raises(StrokeError, match="has no actuator, so its stroke is exact"):
        VirtualStrokeRig(still)


def noise(seed):
    return 30e-6 * np.random.default_rng(seed).standard_normal(len(TIME))
