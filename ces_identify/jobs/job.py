"""One job of many, and its result as a row and the texts of its files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from ces_identify.jobs.row_log import Row
from ces_observer.errors import CesError

DONE, FAILED, CRASHED = "done", "failed", "crashed"


class Job(Protocol):
    """A job; two jobs have the same key if they have the same result."""

    @property
    def key(self) -> str:
        """The key of the job's row."""

    @property
    def identity(self) -> Row:
        """The columns that identify the job in a row, including its key."""

    @property
    def output(self) -> str:
        """The file or folder that a finished job writes, relative to the results folder."""


@dataclass(frozen=True)
class JobResult:
    """The row of a job, and the texts of its files by their path relative to the results folder."""

    row: Row
    files: Mapping[str, str] = field(default_factory=dict)


def run_job(job: Job, work: Callable[[], JobResult]) -> JobResult:
    """Return the result of `work`. A CesError makes the job `failed`, any other error `crashed`.

    A failed job is not repeated; a crashed one is repeated by the next run.
    """
    try:
        return work()
    except CesError as error:
        return failed_job(job, FAILED, str(error))
    except Exception as error:  # one job must not stop the others
        return failed_job(job, CRASHED, describe_error(error))


def failed_job(job: Job, status: str, reason: str) -> JobResult:
    """Return the result of a failed or crashed job."""
    return JobResult({**job.identity, "status": status, "reason": reason})


def describe_error(error: BaseException) -> str:
    """Return an error's class and message in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
