"""The loop: what is kept, when it stops, how it goes on, and Ctrl-C in a search."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf, isnan, nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from browser import find_faults
from iterate_examples import LIMITS, BreakingRig, make_plan, sine_commands, small_rig

from ces_data.bags.writer import recording_topics, write_bag
from ces_data.signals_file import load_signals
from ces_identify.numerics.search import SearchResult
from ces_observer.errors import CesError
from ces_observer.model import load_model
from ces_rig.experiments.commands import write_commands
from ces_rig.loop.iterate import IterateListener, Iterations, evaluate_fresh, find_stop, interruptible
from ces_rig.loop.page import write_page
from ces_rig.loop.rigs import DROP, FolderRig
from ces_rig.loop.store import ROWS, Iteration, keep_inputs

pytestmark = pytest.mark.slow


def rows(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / ROWS).read_text().splitlines()]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("finished")
    reason = Iterations(make_plan(out), small_rig(), out).run()
    assert reason.startswith("budget spent: 6.0 of 6 s")
    return out


def test_every_iteration_is_kept(finished: Path) -> None:
    for number in (1, 2):
        folder = finished / f"iteration_{number:02d}"
        assert {"commands.csv", "design.json", "recording", "model.json", "ensemble_1.json"} <= {
            path.name for path in folder.iterdir()
        }
    first, second = rows(finished)
    assert first["fresh_J"] is None
    assert second["total_s"] == 6.0
    assert second["coverage"] > first["coverage"]


def test_the_fresh_cost_is_that_of_the_model_before(finished: Path) -> None:
    iterations = Iterations(make_plan(finished), small_rig(), finished)
    iterations.run()  # nothing is left to do
    before = load_model(finished / "iteration_01" / "model.json")
    cost = evaluate_fresh(before, iterations.done.recordings[1]).cost
    assert rows(finished)[1]["fresh_J"] == pytest.approx(cost)
    names = [one["recording"] for one in before.provenance["identification"]]
    assert names == ["experiment_01"]


def test_the_page_is_legible_on_screen_in_print_and_by_keys(finished: Path) -> None:
    iterations = Iterations(make_plan(finished), small_rig(), finished)
    iterations.run()  # nothing is left to do
    write_page(finished / "report.html", iterations)
    assert f"<title>Iteration {finished.name}: 2 experiments on the virtual rig</title>" in (
        finished / "report.html"
    ).read_text(encoding="utf-8")
    assert find_faults(finished / "report.html") == []


def test_an_interrupted_iteration_goes_on_to_the_same_results(finished: Path, tmp_path: Path) -> None:
    plan, rig = make_plan(tmp_path), BreakingRig(break_at=2)
    with pytest.raises(KeyboardInterrupt):
        Iterations(plan, rig, tmp_path).run()
    Iterations(plan, rig, tmp_path).run()
    assert rig.runs == 3  # no finished run is repeated
    assert rows(tmp_path) == rows(finished)


def test_a_larger_budget_goes_on_also_after_a_kill_between_recording_and_fit(finished: Path, tmp_path: Path) -> None:
    plan = make_plan(tmp_path, stop={"budget_s": 3.0})
    assert Iterations(plan, small_rig(), tmp_path).run().startswith("budget spent")
    assert len(rows(tmp_path)) == 1
    (tmp_path / ROWS).write_text("")
    (tmp_path / "iteration_01" / "model.json").unlink()
    rig = BreakingRig(0)
    Iterations(make_plan(tmp_path), rig, tmp_path).run()
    assert rig.runs == 1  # only the fit of the first is repeated
    assert rows(tmp_path) == rows(finished)


class FullDisk(IterateListener):
    """There is no room for the page."""

    resumed = 0

    def resume(self, history: Sequence[Iteration]) -> None:
        self.resumed = len(history)

    def finish(self, iteration: Iteration) -> None:
        raise CesError("report.html: full")


def test_a_finished_iteration_is_kept_although_its_page_is_not(finished: Path, tmp_path: Path) -> None:
    for count in range(2):
        listener = FullDisk()
        with pytest.raises(CesError, match="full"):
            Iterations(make_plan(tmp_path), small_rig(), tmp_path, listener).run()
        assert listener.resumed == count
    assert rows(tmp_path) == rows(finished)


def test_a_changed_input_is_refused(tmp_path: Path) -> None:
    plan = make_plan(tmp_path, rig={"kind": "virtual", "damper": "damper.yaml"}, recordings=["bag"])
    recording = replace(small_rig().run(sine_commands(), tmp_path), sha256="1")
    (tmp_path / "damper.yaml").write_text("one")
    keep_inputs(tmp_path, plan, [recording])
    with pytest.raises(CesError, match=r"bag: has changed since .* began with it; choose another out"):
        keep_inputs(tmp_path, plan, [replace(recording, sha256="2")])
    (tmp_path / "damper.yaml").write_text("two")
    with pytest.raises(CesError, match=r"damper.yaml: has changed since"):
        keep_inputs(tmp_path, plan, [recording])


def test_a_target_on_fresh_data_ends_it(tmp_path: Path) -> None:
    plan = make_plan(tmp_path, experiments={"duration_s": 6.0}, stop={"budget_s": 60.0, "target_J": 99.0})
    assert Iterations(plan, small_rig(), tmp_path).run().startswith("target reached")
    assert 2 <= len(rows(tmp_path)) < 10  # of the budget


def test_given_recordings_are_identified_first_and_cost_nothing(tmp_path: Path) -> None:
    for seed, (name, seconds) in enumerate((("bag", 4.0), ("other", 5.0))):
        recording = small_rig().run(sine_commands(name, seconds).repeat(name, seed, 0.0), tmp_path)
        write_bag(tmp_path / name, recording_topics(recording, load_signals()))
    plan = make_plan(tmp_path, recordings=["bag"], validate=["other"], stop={"budget_s": 3.0})
    Iterations(plan, small_rig(), tmp_path / "out").run()
    zeroth, first = rows(tmp_path / "out")
    assert (zeroth["number"], zeroth["total_s"], first["total_s"]) == (0, 0.0, 3.0)
    assert first["fresh_J"] is not None
    assert set(first["validation_J"]) == {"other"}
    twice = make_plan(tmp_path, recordings=["bag"], validate=["bag"], stop={"budget_s": 3.0})
    with pytest.raises(CesError, match="bag: the same recording, for"):
        Iterations(twice, small_rig(), tmp_path / "twice")


def test_a_log_that_exists_already_is_no_new_experiment(tmp_path: Path) -> None:
    for seed, name in enumerate(("judged", "new")):
        recording = small_rig().run(sine_commands().repeat(name, seed, 0.0), tmp_path)
        write_bag(tmp_path / name, recording_topics(recording, load_signals()))
    rig = FolderRig(None, load_signals(), 0.0, note=lambda text: None, sleep=lambda seconds: None)
    out = tmp_path / "out"
    iterations = Iterations(make_plan(tmp_path, rig={"kind": "folder"}, validate=["judged"]), rig, out)
    shutil.copytree(tmp_path / "judged", out / "iteration_01" / DROP / "by mistake")
    with pytest.raises(
        CesError, match=r"iteration_01: the recording from the rig and .*judged: the same recording; an"
    ):
        iterations.run()
    shutil.rmtree(out / "iteration_01" / DROP / "by mistake")
    for step in ("iteration_01", "iteration_02"):
        shutil.copytree(tmp_path / "new", out / step / DROP / "new")
    with pytest.raises(
        CesError, match=r"iteration_02: the recording from the rig and .*iteration_01.recording: the same recording; an"
    ):
        iterations.run()
    assert [row["number"] for row in rows(out)] == [1]


def test_a_repeated_experiment_improves_the_parameters_until_the_cost_stops_falling(tmp_path: Path) -> None:
    write_commands(tmp_path / "mine.csv", sine_commands())
    plan = make_plan(
        tmp_path,
        experiments={"kind": "repeated", "commands": "mine.csv"},
        identify={"structure": "polynomial", "terms": 4, "starts": 1, "threads": 1, "time": 20},
        stop={"budget_s": 60.0, "max_iterations": 6},
    )
    reason = Iterations(plan, small_rig(), tmp_path / "out").run()
    assert reason.startswith("the cost has stopped falling")
    models = [load_model(path) for path in sorted((tmp_path / "out").glob("iteration_*/model.json"))]
    factors = [[term.factors for term in model.body.terms] for model in models]
    assert all(one == factors[0] for one in factors)
    assert all(model.certificate is not None for model in models)
    strokes = [np.loadtxt(p, delimiter=",", skiprows=1) for p in sorted((tmp_path / "out").glob("*/commands.csv"))]
    assert all(np.array_equal(one, strokes[0]) for one in strokes)


def test_a_repeated_experiment_outside_the_limits_is_refused(tmp_path: Path) -> None:
    write_commands(tmp_path / "mine.csv", sine_commands())
    plan = make_plan(
        tmp_path, experiments={"kind": "repeated", "commands": "mine.csv"}, limits={**LIMITS, "stroke_m": 0.005}
    )
    with pytest.raises(CesError, match=r"mine: stroke 0.01 m exceeds"):
        Iterations(plan, small_rig(), tmp_path / "out")


def test_heat_is_carried_on_and_the_damper_rests(tmp_path: Path) -> None:
    heat = {"power_W": 2.0, "memory_s": 5.0, "force_N": 10.0}
    plan = make_plan(tmp_path, limits={**LIMITS, "heat": heat})
    Iterations(plan, small_rig(), tmp_path).run()
    first, second = rows(tmp_path)
    assert first["rest_s"] == 0.0
    assert first["load_W"] > 1.0
    assert second["rest_s"] == pytest.approx(5.0 * np.log(first["load_W"]))


def row(**facts):
    return SimpleNamespace(**{"number": 1, "total_s": 10.0, "fresh_J": None, "fresh_high_J": None, **facts})


def plan(target_J):
    stop = SimpleNamespace(target_J=target_J, max_iterations=9, budget_s=60.0)
    return SimpleNamespace(stop=stop, experiments=SimpleNamespace(kind="designed"))


@pytest.mark.parametrize(
    ("facts", "reached"),
    [
        ({}, False),
        ({"fresh_J": 3.9}, False),  # too short for an interval
        ({"fresh_J": 3.9, "fresh_high_J": 4.1}, False),
        ({"fresh_J": 3.2, "fresh_high_J": 3.9}, True),
    ],
)
def test_a_target_is_reached_when_the_whole_interval_is_below(facts, reached):
    text = find_stop(plan(4.0), [row(**facts)], 10.0)
    assert text.startswith("target reached: J 3.20 %, with 95 % confidence at most 3.90 %") == reached
    assert bool(text) == reached


def test_a_diverged_run_is_null_in_its_line_and_no_number_when_it_is_read_again():
    one = Iteration(2, "two", 3.0, 6.0, 0.0, 0.0, inf, 5.0, {"other": nan}, 0.5, 0.1, 0.1, (), "m.json")
    row = json.loads(json.dumps(one.to_row(), allow_nan=False))
    again = Iteration.from_row(row, Path("iterations.jsonl"))
    assert again.fresh_J is None
    assert isnan(again.validation_J["other"])
    assert (again.number, again.fit_J) == (2, 5.0)


@pytest.fixture(autouse=True)
def _heard() -> Iterator[None]:
    """Hear Ctrl-C also where the tests themselves run in the background, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_caught_interrupt_comes_again_after_the_block() -> None:
    before = signal.getsignal(signal.SIGINT)
    steps = []
    with pytest.raises(KeyboardInterrupt), interruptible():
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        steps.append("the block went on")
    assert steps
    assert signal.getsignal(signal.SIGINT) is before


class InterruptingListener(IterateListener):
    """Ctrl-C comes with the first result of the search."""

    came = False

    def listen_search(self, result: SearchResult) -> None:
        if not self.came:
            self.came = True
            os.kill(os.getpid(), signal.SIGINT)


def test_a_model_of_a_search_that_was_cut_is_not_kept(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        Iterations(make_plan(tmp_path), small_rig(), tmp_path, InterruptingListener()).run()
    assert (tmp_path / "iteration_01" / "recording").exists()
    assert not (tmp_path / "iteration_01" / "model.json").exists()
