"""The load of this process; test_process.py has what it loses."""

from __future__ import annotations

import socket
import sys
from contextlib import suppress
from time import monotonic

import pytest
from patience import wait_until

from ces_observer.health.process import KernelDrops, ProcessWatch


def test_the_load_is_that_since_the_last_update() -> None:
    watch = ProcessWatch()
    watch.update()
    end = monotonic() + 0.05
    while monotonic() < end:
        pass
    load = watch.update()
    assert load.executor is not None
    assert load.process is not None
    assert 0.0 < load.executor <= load.process + 0.1


# --------------------------------------- Datagrams dropped by the kernel, counted at a real socket that nobody reads.


pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux shows the drops of each socket")
SMALL = 4096  # bytes of receive buffer


def test_datagrams_that_nobody_reads_are_counted_once() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reader,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL)
        reader.bind(("127.0.0.1", 0))
        drops = KernelDrops()
        drops.update()
        assert (drops.total, drops.new) == (0, 0)
        for _ in range(100):
            sender.sendto(bytes(1000), reader.getsockname())
        reader.setblocking(False)
        received, new = 0, 0

        def are_all_counted() -> bool:
            """A busy kernel delivers later than it sends."""
            nonlocal received, new
            with suppress(BlockingIOError):
                while reader.recv(2000):
                    received += 1
            drops.update()
            new += drops.new
            return received + drops.total == 100

        wait_until(are_all_counted)
        assert 0 < drops.total == new
        drops.update()
        assert (drops.total, drops.new) == (100 - received, 0)


def test_sockets_of_others_are_not_counted() -> None:
    drops = KernelDrops()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as later,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        later.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL)
        later.bind(("127.0.0.1", 0))
        for _ in range(100):
            sender.sendto(bytes(1000), later.getsockname())
        drops.update()
    assert drops.total == 0
