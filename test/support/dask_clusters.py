"""A Dask scheduler with two workers on this computer, each a process of its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from patience import PATIENCE_S


@contextmanager
def dask_scheduler() -> Iterator[str]:
    """Yield the address of a running scheduler; skips the test where Dask is missing."""
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    with (
        pytest.MonkeyPatch.context() as patch,
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
    ):
        patch.setattr("ces_identify.cluster.CONNECT_S", PATIENCE_S)
        yield cluster.scheduler_address
