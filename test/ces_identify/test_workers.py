"""Processes of this machine and the workers of a real Dask cluster give what this process gives."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from campaign_parts import RULES, made
from dask_clusters import dask_scheduler
from patience import command_of, wait_until

from ces_identify import cluster as cluster_module
from ces_identify.campaign.cell import compute_cell
from ces_identify.campaign.plan import jobs, load_campaign
from ces_identify.cluster import run_on_cluster
from ces_identify.jobs import DONE, JobResult, Task, run_in_processes, run_on_this_machine
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


def describe(job, recordings, own=()):
    """A job that needs no kernels: what it was given."""
    found = {"key": job.key, "status": DONE, "terms": job.cell.settings["terms"], "own": len(own)}
    return JobResult({**found, "sums": [float(r.channel("force").values.sum()) for r in recordings]})


def expected(work, function):
    jobs, recordings = work
    return as_comparable(function(job, [recordings[p] for p in job.paths]) for job in jobs)


def as_comparable(results):
    """Return the results by key, without what was timed."""
    return {r.row["key"]: ({k: v for k, v in r.row.items() if k != "seconds"}, dict(r.files)) for r in results}


def tasks(jobs):
    return [Task(job, job.paths) for job in jobs]


def on_cluster(jobs, recordings, address):
    return run_on_cluster(describe, tasks(jobs), recordings, address)


def test_processes_on_this_machine(work) -> None:
    results = as_comparable(run_on_this_machine(compute_cell, tasks(work[0]), work[1], processes=2, threads=1))
    assert results == expected(work, compute_cell)
    assert sorted({row["status"] for row, _ in results.values()}) == ["done", "failed"]


@pytest.fixture(scope="module")
def cluster():
    """The address of a scheduler with two workers, each a process of its own."""
    with dask_scheduler() as address:
        yield address


def test_two_workers_of_a_dask_scheduler(work, cluster) -> None:
    assert as_comparable(on_cluster(*work, address=cluster)) == expected(work, describe)


@pytest.mark.parametrize("late", [False, True])
def test_workers_of_another_version_are_named(work, cluster, monkeypatch, late):
    monkeypatch.setattr(cluster_module, "__version__", "99.0")
    if late:  # it comes after the check at the start
        monkeypatch.setattr(cluster_module, "_require_same_version", lambda *_: None)
    with pytest.raises(CesError, match=r"worker .* has ces_observer .*; expected ces_observer 99\.0 and Python"):
        list(on_cluster(*work, address=cluster))


def describe_or_die(job, recordings, own):
    """The first time, take the worker and all data on it along."""
    mark = Path(own[0]) / job.key
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return describe(job, recordings)


def test_workers_that_die_lose_nothing(work, cluster, tmp_path):
    jobs, recordings = work
    risky = [Task(job, job.paths, [str(tmp_path)]) for job in jobs]
    found = as_comparable(run_on_cluster(describe_or_die, risky, recordings, cluster))
    assert found == expected(work, describe)
    assert len(list(tmp_path.iterdir())) == len(jobs)


def test_no_scheduler_is_one_line(work, monkeypatch):
    pytest.importorskip("distributed", reason="dask.distributed is not installed")
    monkeypatch.setattr(cluster_module, "CONNECT_S", 1.0)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(CesError, match=f"--dask {address}: no scheduler answered within 1 s"):
            list(on_cluster(*work, address=address))


def test_no_dask_is_one_line(work, monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(cluster_module, "import_module", missing)
    with pytest.raises(CesError, match=r"pip install 'ces_observer\[dask\]'"):
        list(on_cluster(*work, address="127.0.0.1:8786"))


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
