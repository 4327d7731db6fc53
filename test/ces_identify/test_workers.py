"""Processes of this machine give what this process gives."""

import os
import signal
import subprocess
import sys

import pytest
from campaign_parts import RULES, made
from patience import command_of, wait_until

from ces_identify.campaign.cells import compute_cell
from ces_identify.campaign.plan import jobs, load_campaign
from ces_identify.jobs import Task, run_in_processes, run_on_this_machine
from ces_observer.errors import CesError

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """The jobs of a small campaign, one of which must fail, and its recordings."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "rules.yaml").write_text(RULES)
    (folder / "c.yaml").write_text(
        "bags: {one: [one], short: [short]}\nvalidate: {other: two}\n"
        "structures: {polynomial: {terms: 2, candidates: rules.yaml}}\nlimits: {time: 600}\n"
    )
    campaign = load_campaign(folder / "c.yaml")
    recordings = {path: made(seed, name=path.name) for seed, path in enumerate(campaign.paths, start=1)}
    short = next(path for path in campaign.paths if path.name == "short")
    recordings[short] = made(9, seconds=1.0, name="short")
    return jobs(campaign, recordings, ""), recordings


def expected(work, function):
    jobs, recordings = work
    return as_comparable(function(job, [recordings[p] for p in job.paths]) for job in jobs)


def as_comparable(results):
    """Return the results by key, without what was timed."""
    return {r.row["key"]: ({k: v for k, v in r.row.items() if k != "seconds"}, dict(r.files)) for r in results}


def tasks(jobs):
    return [Task(job, job.paths) for job in jobs]


def test_processes_on_this_machine(work) -> None:
    results = as_comparable(run_on_this_machine(compute_cell, tasks(work[0]), work[1], processes=2, threads=1))
    assert results == expected(work, compute_cell)
    assert sorted({row["status"] for row, _ in results.values()}) == ["done", "failed"]


def kill_itself():
    os.kill(os.getpid(), signal.SIGKILL)


SLEEPER = """
import os, sys, time
from pathlib import Path
from ces_identify.jobs import run_in_processes
def sleep():
    Path(sys.argv[1]).write_text(f"{os.getpid()}.")
    time.sleep(600.0)
for _ in run_in_processes(sleep, [()], 2, 1): pass
"""


def test_a_worker_ends_with_its_killed_parent(tmp_path):
    words = [sys.executable, "-c", SLEEPER.replace("sys.argv[1]", repr(str(tmp_path / "pid")))]
    with subprocess.Popen(words) as parent:
        wait_until(lambda: (tmp_path / "pid").is_file() and (tmp_path / "pid").read_text().endswith("."))
        parent.kill()
    worker = (tmp_path / "pid").read_text().strip(".")
    wait_until(lambda: not command_of(worker))


class Unreadable:
    def __reduce__(self):
        return int, ("no number",)


def test_a_killed_process_is_one_line():
    with pytest.raises(CesError, match="a worker process died, perhaps short of memory"):
        list(run_in_processes(kill_itself, [()], processes=2, threads=1))


def test_a_task_that_no_process_can_read_is_one_line_with_the_reason():
    with pytest.raises(CesError, match=r"could not read its task .*\(ValueError: invalid literal for int.*no number"):
        list(run_in_processes(abs, [(Unreadable(),)], processes=2, threads=1))
