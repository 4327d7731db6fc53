"""One job of many: what an engine needs to know of it, and its result as a row and the texts of its files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from ces_identify.jobs.row_log import Row
from ces_observer.errors import CesError

DONE, FAILED, CRASHED = "done", "failed", "crashed"


class Job(Protocol):
    """A job: its key is the same whenever its result would be."""

    @property
    def key(self) -> str:
        """The key of the job's row."""

    @property
    def identity(self) -> Row:
        """The columns that say which job a row belongs to, its key among them."""

    @property
    def output(self) -> str:
        """The file or folder that a finished job leaves, relative to the folder of the results."""


@dataclass(frozen=True)
class JobResult:
    """The row of a job, and the texts of its files by their path relative to the folder of the results."""

    row: Row
    files: Mapping[str, str] = field(default_factory=dict)


def run_job(job: Job, work: Callable[[], JobResult]) -> JobResult:
    """Return what `work` returns. A CesError makes the job `failed`, for good; any other error makes it `crashed`.

    A job that failed would fail again; one that crashed is tried again by the next run.
    """
    try:
        return work()
    except CesError as error:
        return failed_job(job, FAILED, str(error))
    except Exception as error:  # one job must not cost the others of the night
        return failed_job(job, CRASHED, describe_error(error))


def failed_job(job: Job, status: str, reason: str) -> JobResult:
    """Return the result of a job that has none."""
    return JobResult({**job.identity, "status": status, "reason": reason})


def describe_error(error: BaseException) -> str:
    """Return an error's class and message in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
