"""Who diagnoses the units of a fleet: processes on this machine, or the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence

from ces_gap.fleet.answer import CRASHED, Answer, answer, failure
from ces_gap.fleet.question import Job
from ces_identify.campaign.workers import cluster, crash_of, dask_distributed, in_processes
from ces_identify.recordings.recording import Recording

AHEAD = 2  # tasks for each thread of the cluster that are sent ahead

Task = tuple[Job, Sequence[Recording]]


def on_this_machine(
    packed: bytes, tasks: Iterable[Task], processes: int, threads: int
) -> Generator[Answer, None, None]:
    """Yield the answer of each unit to the packed question as it ends, from processes on this machine.

    Raises CesError if a process dies.
    """
    return in_processes(answer, ((job, packed, recordings) for job, recordings in tasks), processes, threads)


def on_cluster(packed: bytes, tasks: Iterable[Task], address: str) -> Generator[Answer, None, None]:
    """Yield the answer of each unit to the packed question as it ends, from the Dask scheduler's workers at `address`.

    Tasks are taken as workers get free, so that few recordings are held at once; the question goes to each worker
    once. Raises CesError if the cluster cannot be used, or goes away.
    """
    with cluster(address) as client:
        question = client.scatter(packed, broadcast=True, hash=False)
        ended = dask_distributed().as_completed(loop=client.loop, raise_errors=False)
        waiting, sent = iter(tasks), {}

        def send(count: int) -> None:
            for _, (job, recordings) in zip(range(count), waiting, strict=False):
                held = client.scatter(list(recordings), hash=False)
                future = client.submit(answer, job, question, held, pure=False)
                sent[future] = job
                ended.add(future)

        send(AHEAD * sum(client.nthreads().values()))
        for future in ended:
            job, reason = sent.pop(future), crash_of(future, address)
            yield future.result() if reason is None else failure(job.key, job.name, CRASHED, reason)
            future.release()
            send(1)
