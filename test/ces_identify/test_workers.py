"""Processes of this machine and the workers of a real Dask cluster give what this process gives."""

import os
import signal
import socket
from dataclasses import replace

import pytest
from campaign_parts import RULES, made
from dask_clusters import dask_scheduler

from ces_identify import jobs as cluster_module
from ces_identify.campaign.cell import compute_cell
from ces_identify.campaign.plan import jobs, load_campaign
from ces_identify.jobs import DONE, JobResult, Task, run_in_processes, run_job, run_on_cluster, run_on_this_machine
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


def describe_or_crash(job, recordings, own=()):
    return run_job(job, lambda: describe(job, recordings, own))


def expected(work, function):
    jobs, recordings = work
    return as_comparable(function(job, [recordings[p] for p in job.paths]) for job in jobs)


def as_comparable(results):
    """Return the results by key, without what was timed."""
    return {r.row["key"]: ({k: v for k, v in r.row.items() if k != "seconds"}, dict(r.files)) for r in results}


def tasks(jobs):
    return [Task(job, job.paths) for job in jobs]


def on_cluster(jobs, recordings, address):
    return run_on_cluster(describe_or_crash, tasks(jobs), recordings, address)


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


def test_a_crash_on_a_worker_is_a_row(work, cluster):
    jobs, recordings = work
    broken = replace(jobs[0], cell=replace(jobs[0].cell, settings={}))
    rows = [result.row for result in on_cluster([broken], recordings, address=cluster)]
    assert [row["status"] for row in rows] == ["crashed"]
    assert "KeyError" in rows[0]["reason"]


def test_workers_of_another_version_are_named(work, cluster, monkeypatch):
    monkeypatch.setattr(cluster_module, "__version__", "99.0")
    with pytest.raises(CesError, match=r"worker tcp://.* has ces_observer .*; install 99\.0 there"):
        list(on_cluster(*work, address=cluster))


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


class Unreadable:
    def __reduce__(self):
        return int, ("no number",)


def test_a_killed_process_is_one_line():
    with pytest.raises(CesError, match="a worker process died, perhaps short of memory"):
        list(run_in_processes(kill_itself, [()], processes=2, threads=1))


def test_a_task_that_no_process_can_read_is_one_line_with_the_reason():
    with pytest.raises(CesError, match=r"could not read its task .*\(ValueError: invalid literal for int.*no number"):
        list(run_in_processes(abs, [(Unreadable(),)], processes=2, threads=1))
